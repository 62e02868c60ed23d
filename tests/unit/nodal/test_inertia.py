"""Inertia of the nodes: bodies off their node beside the mass that neighbours share."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases import nodal_cases as cases
from torchbeam.nodal.discretise import discretise

OFFSETS = (0.5, 0, 0), (0, 0, 0.5), (0.1, 0.3, -0.2)


def rotation_energy_error(N, order, mass, offset, axis=0.0):
    """Of a straight beam of 1 kg and 1 m that turns about its root at 1 rad/s about y, rigidly,
    with a body on its tip: twice its kinetic energy over the moment of inertia, less 1.
    """
    section = tb.Section.from_stiffness(EA=1.0, GA=1.0, GJ=1.0, EI=1.0, mass=1.0)
    beam = tb.Beam.straight(1.0, N, section.shifted(0.0, -axis) if axis else section, order=order)
    model = discretise(tb.Scene(beam, [tb.PointMass(mass, offset=offset)]))
    spin = torch.tensor([0.0, 1, 0]).expand_as(beam.nodes)
    T = model.kinetic_energy(beam.nodes, beam.frames, torch.linalg.cross(spin, beam.nodes), spin)
    exact = 1 / 3 + axis**2 + mass * ((1 + offset[0]) ** 2 + offset[2] ** 2)
    return (2 * T / exact - 1).item()


@pytest.mark.parametrize("axis", [0.0, 0.1])
@pytest.mark.parametrize("offset", OFFSETS)
def test_a_body_off_its_node_turns_with_its_own_inertia(offset, axis):
    """Elements of order 2 have the moment of inertia of a rigid rotation exactly, by Simpson's
    rule; those of order 1 to second order of their length, observed within 0.1 from 16 elements on.
    The mass that neighbours share is the beam's alone.
    """
    for mass in (0.05, 1.0):
        assert_close(rotation_energy_error(3, 2, mass, offset, axis), 0.0, rtol=0, atol=1e-12)
    errors = [abs(rotation_energy_error(N, 1, 0.05, offset, axis)) for N in (16, 32, 64)]
    if offset[0] == 0:  # along the beam terms of second and of third order nearly cancel
        assert_close(cases.orders(errors), torch.full((2,), 2.0), rtol=0, atol=0.1)
    assert max(errors) < 1e-3 and errors[-1] < errors[0] / 8
