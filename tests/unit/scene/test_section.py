"""Section: constructors against the textbook, what is found at construction, gradients. Bad input:
test_refusals.
"""

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.math.quaternions import skew

STIFFNESS = dict(EA=10.0, GA=(4.0, 5.0), GJ=0.5, EI=(1.0, 2.0), mass=0.3, inertia=(0.01, 0.02))


def diagonals(section):
    return section.compliance.diagonal(dim1=-2, dim2=-1), section.mass.diagonal(dim1=-2, dim2=-1)


def test_from_stiffness_puts_every_number_in_its_place():
    """S = diag(1/EA, 1/GA_y, 1/GA_z, 1/GJ, 1/EI_y, 1/EI_z), mass = diag(m, m, m, i_y + i_z, i_y,
    i_z).
    """
    S, mass = diagonals(tb.Section.from_stiffness(**STIFFNESS))
    assert_close(1 / S, torch.tensor([10.0, 4, 5, 0.5, 1, 2]))
    assert_close(mass, torch.tensor([0.3, 0.3, 0.3, 0.03, 0.01, 0.02]))


def test_rectangle():
    """E = 200 GPa, 20 x 10 mm: EA = E b h, EI = E b h^3/12 about y and E h b^3/12 about z, k = 5/6,
    J = 0.2287 b h^3 at b/h = 2 (Timoshenko and Goodier, table in art. 109: four digits).
    """
    b, h, E, nu, rho = 0.02, 0.01, 200e9, 0.3, 7800.0
    S, mass = diagonals(tb.Section.rectangle(b, h, E, nu, rho))
    G = E / 2.6
    kGA = G * b * h / 1.2
    assert_close(
        1 / S[[0, 1, 2, 4, 5]],
        torch.tensor([E * b * h, kGA, kGA, E * b * h**3 / 12, E * h * b**3 / 12]),
    )
    assert_close(1 / S[3] / (G * b * h**3), torch.tensor(0.2287), rtol=0, atol=5e-5)
    assert_close(
        mass[[0, 4, 5]], torch.tensor([rho * b * h, rho * b * h**3 / 12, rho * h * b**3 / 12])
    )


def test_square_torsion():
    """J = 0.14057701495515 a^4 for a square (the series of art. 109 summed to 1e-14 in extended
    precision).
    """
    S, _ = diagonals(tb.Section.rectangle(1.0, 1.0, 2.0, 0.0, 1.0))
    assert_close(1 / S[3], torch.tensor(0.14057701495515), rtol=1e-13, atol=0)


def test_circle():
    """EI = E pi r^4/4, GJ = G pi r^4/2, k = 9/10, polar inertia twice the other."""
    S, mass = diagonals(tb.Section.circle(0.1, 3.0, 0.5, 2.0))
    area, I = math.pi * 0.01, math.pi * 1e-4 / 4
    assert_close(1 / S, torch.tensor([3 * area, 0.9 * area, 0.9 * area, 2 * I, 3 * I, 3 * I]))
    assert_close(mass, torch.tensor([2 * area] * 3 + [4 * I, 2 * I, 2 * I]))


def test_what_is_found_at_construction():
    """rigid: zero rows of S; coupled, offset: off-diagonal entries; rotary: any rotary inertia."""
    plain = tb.Section.from_stiffness(**{**STIFFNESS, "EA": math.inf, "inertia": 0.0})
    assert plain.rigid == (True, False, False, False, False, False)
    assert not (plain.coupled or plain.offset or plain.rotary)
    S, M = torch.eye(6), torch.eye(6)
    S[3, 4] = S[4, 3] = 0.1
    M[1, 5] = M[5, 1] = 0.1
    full = tb.Section(S, M)
    assert full.coupled and full.offset and full.rotary and not any(full.rigid)


def test_batches_broadcast_and_sections_are_double():
    section = tb.Section.from_stiffness(
        EA=1.0, GA=1.0, GJ=1.0, EI=torch.rand(4, 1) + 1, mass=torch.rand(3) + 1
    )
    assert section.batch_shape == (4, 3)
    for radius in (0.1, torch.tensor(0.1, dtype=torch.float32), np.float32(0.1)):
        assert tb.Section.circle(radius, 3.0, 0.5, 2.0).mass.dtype == torch.float64


def test_a_pair_is_a_sequence_and_a_tensor_a_batch():
    """(y, z), entries with batch axes; axes of tensors are batch axes, also of length 2."""
    EI = torch.tensor([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])
    for value, batch, EI_y, EI_z in (
        ((1.0, 2.0), (), 1.0, 2.0),
        (EI.unbind(-1), (3,), EI[:, 0], EI[:, 1]),
        ([[1.0, 3.0], [2.0, 4.0]], (2,), EI[:2, 0], EI[:2, 1]),
        (EI[:2], (2, 2), EI[:2], EI[:2]),
        (EI[0].numpy(), (2,), EI[0], EI[0]),
    ):
        S = tb.Section.from_stiffness(**{**STIFFNESS, "EI": value}).compliance
        assert S.shape[:-2] == batch
        assert_close(1 / S[..., 4, 4], torch.as_tensor(EI_y))
        assert_close(1 / S[..., 5, 5], torch.as_tensor(EI_z))


def test_sections_carry_gradient():
    """Every number of a constructor against central differences."""
    numbers = tuple(torch.tensor(x, requires_grad=True) for x in (0.2, 0.1, 3.0, 0.3, 2.0))

    def both(*x):
        section = tb.Section.rectangle(*x)
        return section.compliance.diagonal(), section.mass.diagonal()

    assert torch.autograd.gradcheck(both, numbers, check_forward_ad=True)


@pytest.mark.parametrize("name", ["EA", "GA", "GJ", "EI"])
def test_infinite_stiffness_is_a_zero_compliance(name):
    S, _ = diagonals(tb.Section.from_stiffness(**{**STIFFNESS, name: math.inf}))
    at = {"EA": [0], "GA": [1, 2], "GJ": [3], "EI": [4, 5]}[name]
    assert (S[at] == 0).all() and (S == 0).sum() == len(at)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_rounding_is_no_asymmetry(dtype):
    """|S_ij - S_ji| counts by sqrt(S_ii S_jj): inverses of 200 stiffnesses about other axes, whose
    entries are differences of large numbers, are sections and exactly symmetric. The bound is 1e-6
    (in float32 1e-4) at every size of the entries.
    """
    stiffness = torch.diag(torch.tensor([1e3, 400, 300, 0.8, 1, 2], dtype=dtype))
    T = torch.eye(6, dtype=dtype).repeat(200, 1, 1)
    T[:, :3, 3:] = -skew(
        0.03 * torch.randn(200, 3, dtype=dtype, generator=torch.Generator().manual_seed(0))
    )
    S = torch.linalg.inv(T.mT @ stiffness @ T)
    assert (S != S.mT).any()
    tb.Section(S.numpy(), torch.eye(6, dtype=dtype))
    S = tb.Section(S, torch.eye(6, dtype=dtype)).compliance
    assert (S == S.mT).all()

    size = torch.tensor([1e-8, 1e-4, 1, 1, 1, 1e2], dtype=dtype)
    bound = 1e-6 if dtype == torch.float64 else 1.2e-4
    for i, j in ((0, 1), (2, 5), (4, 0)):
        S = torch.diag(size)
        S[i, j] = 0.9 * bound * (size[i] * size[j]).sqrt()
        assert tb.Section(S, torch.eye(6, dtype=dtype)).compliance[j, i] == S[i, j] / 2
        with pytest.raises(ValueError, match="compliance that is not symmetric"):
            tb.Section(2 * S - torch.diag(size), torch.eye(6, dtype=dtype))


def test_a_coupling_of_mass_that_is_rounding_alone_is_taken():
    """A section turned and shifted there and back, say: 1e-17 is left of the coupling of V and
    Omega, which is no skew matrix, and counts by the root of mass times inertia. 1e-5 of that root
    is another inertia than that of a rigid body.
    """
    section = tb.Section.from_stiffness(**STIFFNESS)
    for left, taken in ((1e-17, True), (1e-5 * math.sqrt(0.3 * 0.03), False)):
        mass = section.mass.clone()
        mass[3, 0] = mass[0, 3] = left
        scene = tb.Scene(tb.Beam.straight(1.0, 2, tb.Section(section.compliance, mass)))
        if taken:
            assert tb.Stepper(scene, 0.1)
        else:
            with pytest.raises(ValueError, match="otherwise than an offset centre of mass"):
                tb.Stepper(scene, 0.1)
