"""Spectra of scenes in single precision: PyTorch's default, in which a newcomer makes them."""

import warnings

import pytest
import torch

import torchbeam as tb

F32, F64 = torch.float32, torch.float64


@pytest.fixture(params=[F32, F64], autouse=True)
def default(request):
    """By either default dtype; conftest's afterwards."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(request.param)
    yield
    torch.set_default_dtype(before)


def strip(dtype, elements=8, E=69e9):
    """EA is 3e6 times EI/L^2: the squares of the frequencies span more than float32's digits."""
    E = torch.as_tensor(E, dtype=dtype)
    return tb.Beam.straight(
        1.0, elements, tb.Section.rectangle(0.03, 0.002, E=E, nu=0.33, rho=2700.0)
    )


LOADS = {
    "none": lambda beam: tb.Scene(beam),
    "bent": lambda beam: tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0))]),
    "damped": lambda beam: tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0)), tb.Damping(0.01)]),
    "turning": lambda beam: tb.Scene(beam, frame=tb.Frame(angular_velocity=(0, 0, 20.0))),
    "in a plane": lambda beam: tb.Scene(beam, plane="xz"),
}


@pytest.mark.parametrize("name", LOADS)
def test_modes_of_both_precisions_agree(name):
    """About an equilibrium of theirs and about one that is given: within 1e-5, by the rounding of
    what went in. (In float32 the first frequency of the bare strip came out as 0, not 10.25.)
    """
    wanted = tb.modes(LOADS[name](strip(F64)), count=4).eigenvalue
    single = LOADS[name](strip(F32))
    for state in (None, tb.equilibrium(single)):
        modes = tb.modes(single, state, count=4)
        assert modes.eigenvalue.dtype == torch.complex64 and modes.shape.dtype == torch.complex64
        assert (modes.eigenvalue - wanted).abs().max() < 1e-5 * wanted.abs().max()


def test_a_column_in_single_precision_buckles_where_it_does():
    """By a function of the factor and by an input; within 1e-5. (At 16 elements float32 gave a
    fifth of Euler's load.)
    """

    def column(dtype, elements):
        down = torch.tensor([-1.0, 0, 0], dtype=dtype)
        beam = strip(dtype, elements)
        return lambda P: tb.Scene(beam, [tb.TipLoad(force=P[..., None].to(dtype) * down)])

    for elements in (8, 16)[: 1 if torch.get_default_dtype() == F64 else 2]:
        wanted = tb.critical_load(column(F64, elements), 10.0).factor
        single = tb.critical_load(column(F32, elements), 10.0)
        assert single.factor.dtype == F32 and single.shape.dtype == F32
        assert single.factor == pytest.approx(wanted.item(), rel=1e-5)
    pressed = tb.Scene(strip(F32), [tb.TipLoad(force=tb.Input("P", 3))])
    by_input = tb.critical_load(pressed, 10.0, inputs={"P": torch.tensor([-1.0, 0, 0], dtype=F32)})
    assert by_input.factor == pytest.approx(
        tb.critical_load(column(F64, 8), 10.0).factor.item(), rel=1e-5
    )


def test_derivatives():
    """Of a frequency by E: f/(2 E), in single precision."""
    E = torch.tensor(69e9, dtype=F32, requires_grad=True)
    frequency = tb.modes(tb.Scene(strip(F32, E=E)), count=1).frequency[0]
    (slope,) = torch.autograd.grad(frequency, E)
    assert (slope * 2 * 69e9 / frequency).item() == pytest.approx(1.0, rel=1e-4)


def test_functions_that_give_float32_alone_are_told():
    force = torch.tensor([0, 0, 2.0], dtype=F32)
    scene = tb.Scene(strip(F32), [tb.TipLoad(force=lambda t: force)])
    with pytest.warns(UserWarning, match="solved in float32"):
        tb.modes(scene)


def test_a_linear_model_that_single_precision_cannot_hold_is_told():
    """Of a thin strip (in float32 its static gain had the other sign); a soft rod is as it is."""
    soft = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
    rod = tb.Scene(tb.Beam.straight(1.0, 2, soft)).to(F32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tb.linearize(rod).A.dtype == F32
        tb.linearize(tb.Scene(strip(F64)))
    with pytest.warns(UserWarning, match=r"single precision .* torch\.float64 is wanted"):
        tb.linearize(tb.Scene(strip(F32)))
