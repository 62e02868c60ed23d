"""The nodal element: force = -dU, tangents = directional derivatives, objectivity, the arc that
starts unstrained.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import shape, spd
from torchbeam.math import quaternions as quat
from torchbeam.nodal import element as local
from torchbeam.nodal.assembly import Assembly
from torchbeam.nodal.coordinates.spatial import Spatial
from torchbeam.nodal.element import forces, geometric_stiffness, strain_operator, strains
from torchbeam.topology.framework import Framework

N, BATCH = 3, (5,)
ASSEMBLY = Assembly(Framework(1, (N,)), Spatial().interpolation, 3)
to_nodes = ASSEMBLY.to_nodes
# Relative rotations: far, near a half turn, both sides of the series (s2 = 1e-6 is 2e-3 rad), next
# to and at zero.
TURNS = [0.6, 2.1e-3, 1.9e-3, 1e-4, 1e-8, 0.0]
# Sums of a hundred products of size one; next to zero, closed forms divide rounding by |l| down to
# 1e-3.
ROUNDING = dict(rtol=0, atol=1e-11)


@pytest.fixture(params=TURNS)
def element(request):
    """position, rotation, length, a stress and the nine numbers of a direction; element rotation of
    the given size.
    """
    torch.manual_seed(3)
    position, rotation = shape(N + 1, BATCH, request.param)
    length = 0.5 + torch.rand(*BATCH, N, 1)
    return position, rotation, length, torch.randn(*BATCH, N, 6), torch.randn(*BATCH, N + 1, 6)


def kinematics(position, rotation, length):
    """Of the elements of a chain."""
    return local.kinematics(*ASSEMBLY.poses(position, rotation), length)


def perturbed(position, rotation, move):
    """Nodes moved by dr and turned by a spin, frame a."""
    return position + move[..., :3], quat.multiply(quat.exponential(move[..., 3:]), rotation)


def nine(move):
    """(dr_j - dr_i, spin i, spin j) of the elements."""
    return torch.cat((move[..., :3].diff(dim=-2), move[..., :-1, 3:], move[..., 1:, 3:]), -1)


def along(function, position, rotation, move):
    """Directional derivative of a function of position and rotation."""
    return torch.func.jvp(
        lambda m: function(*perturbed(position, rotation, m)), (torch.zeros_like(move),), (move,)
    )[1]


def test_strain_operator_is_the_derivative_of_the_strain(element):
    """B (dr, spins) against forward mode."""
    position, rotation, length, _, move = element
    B = strain_operator(kinematics(position, rotation, length), length)
    exact = along(lambda r, q: strains(kinematics(r, q, length), length), position, rotation, move)
    assert_close((B @ nine(move)[..., None])[..., 0], exact, **ROUNDING)


def test_forces_are_the_gradient_of_the_energy(element):
    """U = sum h/2 e^T S^-1 e with coupled S and a reference strain; nodal force = dU/dr,
    moment = dU/d(spin).
    """
    position, rotation, length, stress, move = element
    K, start = spd(*BATCH, N), 0.1 * torch.randn(*BATCH, N, 6)

    def energy(m):
        r, q = perturbed(position, rotation, m)
        e = strains(kinematics(r, q, length), length, start)
        return (length * e * (K @ e[..., None])[..., 0]).sum() / 2

    kin = kinematics(position, rotation, length)
    stress = (K @ strains(kin, length, start)[..., None])[..., 0]
    gradient = torch.func.grad(energy)(torch.zeros_like(move))
    assert_close(to_nodes(forces(kin, stress, length)), gradient, **ROUNDING)


def test_forces_are_the_transpose_of_the_strain_operator(element):
    """forces = h B^T [F; M]: the closed form without the matrix."""
    position, rotation, length, stress, _ = element
    kin = kinematics(position, rotation, length)
    B = strain_operator(kin, length)
    assert_close(
        forces(kin, stress, length), length * (B.mT @ stress[..., None])[..., 0], **ROUNDING
    )


def test_geometric_stiffness_is_the_derivative_of_the_forces(element):
    """At fixed stress, against forward mode. (The closed form; its first three rows and columns
    hold F, the rest P, Q.)
    """
    position, rotation, length, stress, move = element
    K = geometric_stiffness(kinematics(position, rotation, length), stress, length)
    exact = along(
        lambda r, q: forces(kinematics(r, q, length), stress, length), position, rotation, move
    )
    assert_close((K @ nine(move)[..., None])[..., 0], exact, **ROUNDING)


def test_whole_tangent_is_the_second_derivative_along_a_line(element):
    """d/ds of to_nodes(h B^T S^-1 strain) = (K_geometric + h B^T S^-1 B) move, assembled in
    blocks.
    """
    position, rotation, length, _, move = element
    K = spd(*BATCH, N)

    def force(r, q):
        kin = kinematics(r, q, length)
        return to_nodes(forces(kin, (K @ strains(kin, length)[..., None])[..., 0], length))

    kin = kinematics(position, rotation, length)
    stress = (K @ strains(kin, length)[..., None])[..., 0]
    B = strain_operator(kin, length)
    product = ASSEMBLY.to_matrix(
        geometric_stiffness(kin, stress, length) + length[..., None] * B.mT @ K @ B
    ).times(move)
    # stresses of size ten here
    assert_close(product, along(force, position, rotation, move), rtol=0, atol=1e-10)


def test_strains_are_objective(element):
    """A rigid motion of all nodes changes no strain; nor does the sign of any quaternion."""
    position, rotation, length, _, _ = element
    Q = quat.normalize(torch.randn(4))
    moved = quat.rotate(Q, position) + torch.randn(3), quat.multiply(Q, rotation)
    sign = torch.where(torch.rand(*BATCH, N + 1, 1) < 0.5, -1.0, 1.0)
    before = strains(kinematics(position, rotation, length), length)
    assert_close(strains(kinematics(*moved, length), length), before, rtol=0, atol=1e-13)
    assert_close(
        strains(kinematics(position, sign * rotation, length), length), before, rtol=0, atol=1e-14
    )


def test_internal_forces_are_in_equilibrium(element):
    """No resultant force and no resultant moment about any point, whatever the stress."""
    position, rotation, length, stress, _ = element
    f = to_nodes(forces(kinematics(position, rotation, length), stress, length))
    assert_close(f[..., :3].sum(-2), torch.zeros(*BATCH, 3), rtol=0, atol=1e-13)
    moment = torch.linalg.cross(position, f[..., :3]) + f[..., 3:]
    assert_close(moment.sum(-2), torch.zeros(*BATCH, 3), rtol=0, atol=1e-13)


@pytest.mark.parametrize("beam", ["straight", "arc", "from_nodes"])
def test_undeformed_beams_carry_no_strain(beam):
    """The reference strain is taken off: zero strain and zero energy as built, a curved beam
    too.
    """
    section = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
    torch.manual_seed(0)
    nodes = torch.randn(5, 3).cumsum(0)
    beams = {
        "straight": lambda: tb.Beam.straight(2.0, 4, section, direction=(1, 2, 3)),
        "arc": lambda: tb.Beam.arc(2.0, 3.0, 4, section),
        "from_nodes": lambda: tb.Beam.from_nodes(nodes, section),
    }
    state = tb.equilibrium(tb.Scene(beams[beam]()))
    assert_close(state.position, beams[beam]().nodes, rtol=0, atol=0)
    assert_close(state.stress, torch.zeros(4, 6), rtol=0, atol=1e-14)


def test_curvature_of_a_circle_is_exact():
    """Nodes turned by phi against each other have curvature phi/h whatever phi (up to pi): not 4
    tan(phi/4)/h.
    """
    for phi in (0.1, 1.0, 3.0):
        angle = phi * torch.arange(4)
        rotation = quat.exponential(torch.stack((0 * angle, 0 * angle, angle), -1))
        e = strains(
            kinematics(torch.zeros(4, 3), rotation, torch.full((3, 1), 0.5)),
            torch.full((3, 1), 0.5),
        )
        assert_close(e[:, 5], torch.full((3,), 2 * phi), rtol=1e-14, atol=0)
