"""Inertia of what neither stretches, shears nor bends: that of a rigid body made of bars, on every
mesh.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import inertia, spd
from torchbeam.extend import quaternions as quat
from torchbeam.nodal.discretise import discretise

RIGID = tb.Section.from_stiffness(
    EA=math.inf, GA=math.inf, GJ=math.inf, EI=math.inf, mass=2.0, inertia=(0.01, 0.02)
)
SOFT = tb.Section.from_stiffness(EA=10.0, GA=5.0, GJ=0.1, EI=0.1, mass=0.7, inertia=1e-3)


def section():
    """Random, rigid, its mass off the axis."""
    m, e = 0.2 + torch.rand(()), 0.2 * torch.randn(3) * torch.tensor([0, 1.0, 1.0])
    S = quat.skew(e)
    J = inertia(0.05 * spd(size=3)) + m * S.mT @ S
    mass = torch.cat((torch.cat((m * torch.eye(3), -m * S), -1), torch.cat((m * S, J), -1)), -2)
    return tb.Section(torch.zeros(6, 6), mass)


def moving(beam, v, w, about):
    """Velocities, spins in section axes of nodes that turn rigidly."""
    spin = w.expand_as(beam.nodes)
    return v + torch.linalg.cross(spin, beam.nodes - about), quat.rotate(
        quat.conjugate(beam.frames), spin
    )


def energy_of_bars(beam, v, w, about):
    """Of uniform bars between the ends of the elements: Simpson's rule, exact for squares."""
    ends, step = beam.nodes[..., :-1, :], beam.nodes.diff(dim=-2)
    R = quat.matrix(beam.elements)
    T = 0.0
    for s, weight in ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6)):
        u = v + torch.linalg.cross(w.expand_as(step), ends + s * step - about)
        twist = torch.cat((u[..., None, :] @ R, (w @ R)[..., None, :]), -1)
        T = T + weight * beam.length * (twist @ beam.mass @ twist.mT)[..., 0, 0] / 2
    return T.sum(-1)


def energy_of_body(body, beam, v, w, about):
    row = body.node % beam.node_count
    R = quat.matrix(beam.frames[..., row, :])
    x = beam.nodes[..., row, :] + R @ torch.as_tensor(body.offset)
    u = v + torch.linalg.cross(w, x - about)
    return torch.as_tensor(body.mass) * (u @ u) / 2


@pytest.mark.filterwarnings("ignore:linked interpolation was given elements")
@pytest.mark.parametrize("linked", [False, True])
@pytest.mark.parametrize("elements", [*range(1, 9)])
def test_random_bars(elements, linked):
    """Chains of uneven rigid elements with kinks, each of a section of its own with its mass off
    the axis, and bodies off their nodes: the energy of any rigid motion, to rounding of 1e-12.
    """
    torch.manual_seed(elements)
    for bodies in (0, 2):
        step = torch.tensor([1.0, 0, 0]) + 0.5 * torch.randn(elements, 3)
        nodes = torch.nn.functional.pad(step.cumsum(-2), (0, 0, 1, 0))
        beam = tb.Beam.from_nodes(nodes, [section() for _ in range(elements)])
        masses = [
            tb.PointMass(mass=0.1 + k, node=-k, offset=tuple(torch.randn(3).tolist()))
            for k in range(bodies)
        ]
        model = discretise(tb.Scene(beam.linked() if linked else beam, masses))
        for _ in range(3):
            motion = torch.randn(3), torch.randn(3), torch.randn(3)
            want = energy_of_bars(beam, *motion)
            want = want + sum(energy_of_body(body, beam, *motion) for body in masses)
            T = model.kinetic_energy(beam.nodes, beam.frames, *moving(beam, *motion))
            assert_close(T, want, rtol=1e-12, atol=0)


@pytest.mark.parametrize("options", [{}, {"plane": "xz"}, {"small": True}], ids=str)
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("elements", [1, 2, 3, 8])
def test_a_link_about_its_end(elements, order, options):
    """A link of 1 m on a spring swings with m L^2/3 and the section's own; 1e-6: in `modes` what is
    rigid has a small flexibility. It was 11.1, 3.0, 1.3, 0.2 % slower with 1, 2, 3, 8 elements.
    """
    beam = tb.Beam.straight(1.0, elements, RIGID, order=order)
    found = tb.modes(
        tb.Scene(
            beam,
            [tb.Spring(-1, 5.0, to=(1.0, 0, 0))],
            supports=[tb.Support(0, rotation="xz")],
            **options,
        ),
        count=1,
    ).frequency
    assert_close(found[0], torch.tensor(math.sqrt(5.0 / (2 / 3 + 0.01))), rtol=1e-6, atol=0)


def test_a_rigid_part_beside_a_flexible_one():
    """In a structure each element by itself: the flexible beam's mass is as it is alone, in a batch
    a sample is rigid by itself.
    """
    soft = tb.Beam.straight(1.0, 3, SOFT)
    link = tb.Beam.straight(0.5, 2, RIGID, root=(1.0, 0, 0))
    for linked in (False, True):
        parts = [x.linked() if linked else x for x in (soft, link)]
        both = discretise(tb.Scene({"soft": parts[0], "link": parts[1]}))
        alone = [discretise(tb.Scene(x)) for x in parts]
        masses = [
            x.inertia.translational.matrix(torch.eye(3)).diagonal[..., 0, 0] for x in (both, *alone)
        ]
        assert_close(masses[0], torch.cat(masses[1:]), rtol=1e-14, atol=0)
    S = torch.stack((RIGID.compliance, SOFT.compliance))
    mixed = tb.Beam.straight(0.5, 2, tb.Section(S, RIGID.mass))
    shared = discretise(tb.Scene(mixed)).inertia.translational.coupling
    assert_close(shared[:, 0, 0], 2.0 * 0.25 * torch.tensor([1 / 6, 1 / 12]))


def test_elements_that_bend_keep_their_mass():
    """Where it can stretch (whose frequencies are of fourth order by this), where one of both
    bendings is possible, or a shear, the mass stays half consistent; in a plane what is outside of
    it does not matter.
    """
    for EA, EI, GA, plane, part in (
        (math.inf, (1.0, math.inf), math.inf, None, 1 / 12),
        (math.inf, (1.0, math.inf), math.inf, "xy", 1 / 6),
        (math.inf, (1.0, math.inf), math.inf, "xz", 1 / 12),
        (math.inf, math.inf, (1.0, math.inf), None, 1 / 12),
        (math.inf, math.inf, math.inf, None, 1 / 6),
        (1.0, math.inf, math.inf, None, 1 / 12),
    ):
        of = tb.Section.from_stiffness(EA=EA, GA=GA, GJ=1.0, EI=EI, mass=1.0)
        model = discretise(tb.Scene(tb.Beam.straight(1.0, 1, of), plane=plane))
        assert_close(model.inertia.translational.coupling.item(), part)
