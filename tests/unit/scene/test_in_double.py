"""Statics and spectra of scenes in single precision are computed in double, and rounded."""

import warnings
from dataclasses import replace

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


def strip(elements=8, E=69e9):
    """EA is 3e6 times EI/L^2: the squares of the frequencies span more than float32's digits."""
    section = tb.Section.rectangle(0.03, 0.002, E=E, nu=0.33, rho=2700.0)
    return tb.Beam.straight(1.0, elements, section)


def pushed(elements, dtype):
    return tb.Scene(strip(elements), [tb.TipLoad(force=(0, 0, 2.0))], dtype=dtype)


LOADS = {
    "none": lambda beam, dtype: tb.Scene(beam, dtype=dtype),
    "bent": lambda beam, dtype: tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0))], dtype=dtype),
    "damped": lambda beam, dtype: tb.Scene(
        beam, [tb.TipLoad(force=(0, 0, 2.0)), tb.Damping(0.01)], dtype=dtype
    ),
    "turning": lambda beam, dtype: tb.Scene(
        beam, frame=tb.Frame(angular_velocity=(0, 0, 20.0)), dtype=dtype
    ),
    "in a plane": lambda beam, dtype: tb.Scene(beam, plane="xz", dtype=dtype),
}


@pytest.mark.parametrize("elements", [8, 24, 64])
def test_equilibria(elements):
    """To float32's rounding. (At 24 elements and more float32 found none.)"""
    single, wanted = (tb.equilibrium(pushed(elements, dtype)) for dtype in (F32, F64))
    assert wanted.tip.position[2].item() == pytest.approx(0.401, abs=1e-3)
    assert wanted.position.dtype == F64 and single.status.dtype == torch.long
    for name in ("position", "rotation", "stress", "reaction"):
        a, b = getattr(single, name), getattr(wanted, name)
        assert a.dtype == F32 and (a - b).abs().max() < 1e-6 * b.abs().max()


def test_paths():
    """Of the same points; what is asked of `control` has double precision."""
    seen = set()

    def rise(state):
        seen.add(state.position.dtype)
        return state.tip.position[..., 2]

    for options in ({}, dict(control=rise, target=torch.tensor(0.2))):
        single, wanted = (tb.path(pushed(24, dtype), step=0.5, **options) for dtype in (F32, F64))
        assert single.factor.dtype == single.state.position.dtype == F32 and single.reached
        torch.testing.assert_close(single.factor.double(), wanted.factor, rtol=1e-6, atol=0)
    assert seen == {F64}


@pytest.mark.parametrize("name", LOADS)
def test_modes_of_both_precisions_agree(name):
    """About an equilibrium of theirs and about one that is given: within 1e-5, by the rounding of
    what went in. (In float32 the first frequency of the bare strip came out as 0, not 10.25.)
    """
    wanted = tb.modes(LOADS[name](strip(), F64), count=4).eigenvalue
    single = LOADS[name](strip(), F32)
    for state in (None, tb.equilibrium(single)):
        modes = tb.modes(single, state, count=4)
        assert modes.eigenvalue.dtype == torch.complex64 and modes.shape.dtype == torch.complex64
        assert (modes.eigenvalue - wanted).abs().max() < 1e-5 * wanted.abs().max()


def test_a_column_in_single_precision_buckles_where_it_does():
    """By a function of the factor and by an input; within 1e-5. (At 16 elements float32 gave a
    fifth of Euler's load.)
    """
    down = torch.tensor([-1.0, 0, 0])

    def column(dtype, elements):
        return lambda P: tb.Scene(
            strip(elements), [tb.TipLoad(force=P[..., None] * down)], dtype=dtype
        )

    for elements in (8, 16)[: 1 if torch.get_default_dtype() == F64 else 2]:
        wanted = tb.critical_load(column(F64, elements), 10.0).factor
        single = tb.critical_load(column(F32, elements), 10.0)
        assert single.factor.dtype == F32 and single.shape.dtype == F32
        assert single.factor == pytest.approx(wanted.item(), rel=1e-5)
    pressed = tb.Scene(strip(), [tb.TipLoad(force=tb.Input("P", 3))], dtype=F32)
    by_input = tb.critical_load(pressed, 10.0, inputs={"P": down})
    assert by_input.factor == pytest.approx(
        tb.critical_load(column(F64, 8), 10.0).factor.item(), rel=1e-5
    )


def test_derivatives():
    """Of a frequency by E: f/(2 E), in single precision."""
    E = torch.tensor(69e9, dtype=F32, requires_grad=True)
    for dtype in (F32, F64):
        frequency = tb.modes(tb.Scene(strip(E=E), dtype=dtype), count=1).frequency[0]
        (slope,) = torch.autograd.grad(frequency, E)
        assert frequency.dtype == dtype and slope.dtype == F32
        assert (slope * 2 * 69e9 / frequency).item() == pytest.approx(1.0, rel=1e-4)


def test_functions_that_take_float32_alone_are_told():
    """A network of single precision: in a scene of double a sentence, in one of single statics are
    solved there, with a warning, and steps are made.
    """
    network = torch.nn.Linear(3, 3).float()

    def drag(x, R, v, w, t):
        return -1e-3 * network(v), None

    scene = tb.Scene(strip(), [tb.Load(drag, node=-1, of="velocity")])
    for call in (tb.equilibrium, lambda scene: tb.Stepper(scene, 1e-3)(tb.rest(scene))):
        with pytest.raises(ValueError, match=r"not take torch.float64.*network\.double\(\)"):
            call(scene)
    with pytest.warns(UserWarning, match="solved in float32"):
        assert tb.equilibrium(scene.to(F32)).position.dtype == F32
    single = tb.Stepper(scene.to(F32), 1e-3)
    assert single(single.rest()).status == 0
    network.double()
    assert tb.equilibrium(scene).status == 0


def test_a_linear_model_that_single_precision_cannot_hold_is_told():
    """Of a thin strip (in float32 its static gain had the other sign); a soft rod is as it is. It
    is that of double precision, rounded.
    """
    soft = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
    rod = tb.Scene(tb.Beam.straight(1.0, 2, soft), dtype=F32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert tb.linearize(rod).A.dtype == F32
        tb.linearize(tb.Scene(strip()))
    sensors = tb.sensors.TipPosition(), tb.sensors.Strain(0.3, strip())
    driven = tb.Scene(strip(), [tb.TipLoad(force=tb.Input("u", 3))], dtype=F32)
    given = dict(outputs=sensors, inputs={"u": (0.0, 0, 1.0)})
    with pytest.warns(UserWarning, match=r"single precision .* torch\.float64 is wanted"):
        single = tb.linearize(driven, **given)
    wanted = tb.linearize(replace(driven, dtype=None), **given)
    for name in "ABCD":
        a, b = getattr(single, name), getattr(wanted, name)
        assert a.dtype == F32 and (a - b).abs().max() <= 1e-6 * b.abs().max()
    assert single.departure(single.state).abs().max() < 1e-5


def test_what_is_no_question_of_precision_is_raised_at_once():
    """A function of the scene's that refuses something of its own is asked once, in double."""
    seen = []

    def force(t):
        seen.append(t.dtype)
        raise ValueError("no such push")

    scene = tb.Scene(strip(), [tb.TipLoad(force=force)], dtype=F32)
    with pytest.raises(ValueError, match="no such push"):
        tb.equilibrium(scene)
    assert seen and set(seen) == {F64}
