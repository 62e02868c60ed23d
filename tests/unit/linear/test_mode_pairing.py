"""Mode pairing: modal assurance, pairs over a crossing of frequencies, derivatives, a fit to modal
data.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb


def strip(ratio, N=6, EI=1.0, GJ=2.0):
    """Modes in 3D of a cantilever with EI about y, and `ratio` times that about z."""
    section = tb.Section.from_stiffness(
        EA=1e5, GA=1e5, GJ=GJ, EI=(EI + 0 * ratio, EI * ratio), mass=0.2, inertia=1e-5
    )
    return tb.modes(tb.Scene(tb.Beam.straight(1.0, N, section)), count=5)


def read(shape):
    """y and z of every second node (..., modes, 6)."""
    return shape[..., 2::2, 1:3].flatten(-2)


def measured():
    """Shapes (3, 6) of the first bending about y, the first about z, the second about y."""
    shapes = read(strip(torch.tensor(20.0)).shape).real
    return shapes[:3]


def test_modal_assurance():
    """1 for multiples, real or complex, 0 for what is orthogonal or zero, cos^2 of the angle
    between real ones.
    """
    a = torch.tensor([[1.0, 0.0], [0.0, 0.0]])
    b = torch.tensor([[-3.0, 0.0], [0.0, 2.0], [1.0, 1.0]])
    assert_close(tb.modal_assurance(a, b), torch.tensor([[1.0, 0.0, 0.5], [0.0, 0.0, 0.0]]))
    assert_close(
        tb.modal_assurance(a[:1] * (1 + 2j), b.to(torch.complex128)), tb.modal_assurance(a[:1], b)
    )
    assert tb.modal_assurance(a.expand(4, 2, 2), b).shape == (4, 2, 3)


def test_pairs_over_a_crossing():
    """The first bending about z meets the second about y where EI_z = 6.267^2 EI_y: on both sides
    it is the second of the pairs, with a frequency that is its own, sqrt(EI_z) times one constant;
    a measured shape's scale does not matter.
    """
    ratio = torch.tensor([20.0, 60.0])
    modes, shapes = strip(ratio), measured() * torch.tensor([[-3.0], [0.1], [7.0]])
    pairs = tb.pair_modes(modes, shapes, read)
    assert pairs.index.tolist() == [[0, 1, 2], [0, 2, 1]]
    # shear, rotary inertia: 1e-3
    assert_close(pairs.frequency[:, 1] / pairs.frequency[:, 0], ratio.sqrt(), rtol=2e-3, atol=0)
    assert_close(pairs.shape, shapes.expand(2, 3, 6), rtol=0, atol=2e-4 * 7)
    assert_close(pairs.mac, torch.ones(2, 3), rtol=0, atol=1e-6)
    assert_close(modes.damping_ratio.gather(-1, pairs.index), pairs.damping_ratio)
    assert (
        not pairs.shape.is_complex() and tb.pair_modes(modes, shapes + 0j, read).shape.is_complex()
    )


def test_a_mode_that_no_channel_sees_is_paired_last():
    """Torsion moves no node of the axis: its rounding is like no shape."""
    modes = strip(torch.tensor(3.0), EI=10.0, GJ=0.2)
    seen = read(modes.shape).abs().amax(-1) > 1e-6
    assert not seen.all()
    order = seen.nonzero()[:, 0]
    pairs = tb.pair_modes(modes, read(modes.shape).real[order], read)
    assert pairs.index.tolist() == order.tolist()


def test_derivatives():
    """Frequencies and scaled shapes by EI and the ratio, forward and backward, against central
    differences.
    """
    shapes = measured() + 0.05 * torch.cos(torch.arange(18.0)).reshape(3, 6)

    def of(p):
        pairs = tb.pair_modes(strip(p[1], EI=p[0]), shapes, read)
        return torch.cat((pairs.frequency, pairs.shape.flatten(), pairs.mac))

    p, way = torch.tensor([1.0, 60.0]), torch.tensor([0.3, 10.0])
    wanted = (of(p + 1e-4 * way) - of(p - 1e-4 * way)) / 2e-4
    forward = torch.func.jvp(of, (p,), (way,))[1]
    assert_close(forward, wanted, rtol=0, atol=1e-6 * wanted.abs().max().item())
    weight = torch.cos(torch.arange(len(wanted)).to(wanted))
    leaf = p.clone().requires_grad_()
    (slope,) = torch.autograd.grad(weight @ of(leaf), leaf)
    assert_close(slope @ way, weight @ forward, rtol=0, atol=1e-9 * wanted.abs().max().item())


def test_refusals():
    modes, shapes = strip(torch.tensor(20.0)), measured()
    for wrong, said in (
        (shapes[:, :5], "like the measured channels"),
        (torch.zeros(2, 6), "zero at all channels"),
        (shapes.repeat(2, 1), "5 computed modes were given for 6"),
        (shapes[0], r"\(modes, channels\) is wanted"),
    ):
        with pytest.raises(ValueError, match=said):
            tb.pair_modes(modes, wrong, read)
    with pytest.raises(ValueError, match="as many are wanted"):
        tb.modal_assurance(shapes, shapes[:, :2])
    with pytest.raises(ValueError, match="a function of shape is wanted"):
        tb.pair_modes(modes, shapes, None)
