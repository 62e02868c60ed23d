"""Explicit integration: every method of torchdiffeq, failed samples, the hook between outputs, the
adjoint's check.
"""

import math

import pytest
import torch
from torch.testing import assert_close
from torchdiffeq._impl.odeint import SOLVERS
from torchdiffeq._impl.solvers import AdaptiveStepsizeODESolver

from torchbeam.dynamics.torchdiffeq_bridge import ADAPTIVE, METHODS, integrate

torch.set_default_dtype(torch.float64)
T = torch.linspace(0, 1, 201)
# Error of an oscillator over one second at omega = 2: from each method's order at 5 ms, or the
# local tolerance of 1e-8 times the steps (the fewer, the higher the order); dopri8 steps over
# several outputs and interpolates with a quartic.
BOUND = {
    "euler": 2e-2, "midpoint": 1e-4, "heun2": 1e-4, "heun3": 1e-6, "rk4": 1e-8,
    "explicit_adams": 1e-6, "implicit_adams": 1e-6, "fixed_adams": 1e-6, "scipy_solver": 1e-6,
    "dopri8": 5e-5, "dopri5": 1e-6, "bosh3": 5e-5, "fehlberg2": 5e-5, "adaptive_heun": 5e-5,
}  # fmt: skip
OPTIONS = {"explicit_adams": {"max_order": 4}}  # its default, order 12, is unstable at this step


def oscillator(omega=2.0):
    return lambda t, y: torch.stack((y[..., 1], -(omega**2) * y[..., 0]), -1)


@pytest.mark.filterwarnings("ignore:Functional iteration did not converge")
@pytest.mark.parametrize(
    "method", [pytest.param(m, marks=[pytest.mark.long] * (m == "adaptive_heun")) for m in METHODS]
)
def test_every_method_solves_the_oscillator(method):
    """y'' = -4 y, y(0) = 1, y'(0) = 0: y = cos 2t exactly."""
    ys, status, evaluations = integrate(
        oscillator(), torch.tensor([[1.0, 0]]), T, method=method, rtol=1e-8, atol=1e-8,
        options=OPTIONS.get(method),
    )  # fmt: skip
    assert_close(ys[:, 0, 0], torch.cos(2 * T), rtol=0, atol=BOUND[method])
    assert (status == 0).all() and evaluations > 0


def test_names_are_those_of_torchdiffeq():
    """Which is not imported before it is used."""
    assert set(METHODS) == set(SOLVERS)
    assert set(ADAPTIVE) == {
        name for name, kind in SOLVERS.items() if issubclass(kind, AdaptiveStepsizeODESolver)
    }


def test_unknown_method_is_refused():
    with pytest.raises(ValueError, match="'magic' was given; torchdiffeq has dopri8, dopri5"):
        integrate(oscillator(), torch.ones(2), T, method="magic")


def test_largest_error_is_controlled():
    """One fast sample (omega = 40) beside 4095 at rest keeps 1e-4; torchdiffeq's mean square norm
    loses it.
    """
    y0 = torch.zeros(4096, 2).index_fill(0, torch.tensor([7]), 1.0)
    exact = math.cos(40) + math.sin(40) / 40
    for norm, good in (({}, True), ({"norm": lambda r: r.square().mean().sqrt()}, False)):
        ys, _, _ = integrate(oscillator(40.0), y0, T[[0, -1]], rtol=1e-6, atol=1e-6, options=norm)
        assert (abs(ys[-1, 7, 0].item() - exact) < 1e-4) == good


@pytest.mark.parametrize("method", ["dopri5", "bosh3", "rk4", "euler"])
def test_failed_sample_is_named_and_leaves_its_neighbours_alone(method):
    """y' = y^2 blows up at t = 1/y(0): 0.5 s for the second sample; y = 1/(1/y(0) - t) for the
    others, who get exactly what they get alone (the failed one is taken out and the rest solved
    again); with adaptive steps to the tolerance, for the choice of the first step looks at every
    sample.
    """

    def square(t, y):
        return torch.where(y > 1e6, torch.inf, y * y)  # infinite rather than merely large

    t = torch.linspace(0, 0.8, 161)
    y0 = torch.tensor([[0.5], [2.0], [0.25]])
    with pytest.warns(
        RuntimeWarning,
        match=rf"{method} failed on sample 1 \(1 of 3\) after t = 0\.[45].*nodal form",
    ):
        ys, status, _ = integrate(square, y0, t, method=method)
    assert status[-1].tolist() == [0, 3, 0] and torch.isfinite(ys).all()
    alone, _, _ = integrate(square, y0[[0, 2]], t, method=method)
    assert_close(ys[:, [0, 2]], alone, rtol=0, atol=1e-7 if method in ADAPTIVE else 0)
    assert_close(ys[80, 1], 1 / (0.5 - t[80:81]), rtol=2e-1 if method == "euler" else 1e-3, atol=0)
    assert (ys[120:, 1] == ys[120, 1]).all()


def test_sentence_where_every_sample_failed():
    """tan t has a pole at pi/2: rates of y' = 1 + y^2 grow without bound."""
    with pytest.raises(
        RuntimeError,
        match=r"dopri5 failed on the sample after t = 1\.5.*'midpoint' of the nodal form",
    ):
        integrate(lambda t, y: 1 + y * y, torch.zeros(1), torch.linspace(0, 2, 41))


def test_start_that_is_not_finite():
    y0 = torch.tensor([[math.nan, 0], [1.0, 0]])
    for method in ("dopri5", "rk4"):
        with pytest.warns(RuntimeWarning, match="sample 0"):
            ys, status, _ = integrate(oscillator(), y0, T, method=method)
        assert status[-1].tolist() == [3, 0] and torch.isfinite(ys[:, 1]).all()


@pytest.mark.parametrize("method", ["dopri5", "rk4"])
def test_hook_between_outputs(method):
    """A rotation kept on the unit circle: the hook's result is the output and what the next
    interval starts from.
    """

    def unit(t, y):
        return y / y.norm(dim=-1, keepdim=True)

    spin = oscillator(1.0)
    ys, _, evaluations = integrate(
        spin, torch.tensor([1.0, 0]), T, method=method, rtol=1e-4, after=unit
    )
    assert_close(ys.norm(dim=-1), torch.ones(len(T)), rtol=0, atol=1e-15)
    assert_close(ys[:, 0], torch.cos(T), rtol=0, atol=1e-5)
    assert evaluations < 9 * len(T)  # no search for a first step at each output


def test_gradient_through_the_steps_and_by_the_adjoint():
    """d cos(omega)/d omega = -sin(omega) at t = 1, both ways."""
    for adjoint in (False, True):
        omega = torch.tensor(2.0, requires_grad=True)
        ys, _, _ = integrate(
            oscillator(omega), torch.tensor([1.0, 0]), T[::50], rtol=1e-9, atol=1e-9,
            adjoint=adjoint, parameters=(omega,),
        )  # fmt: skip
        (gradient,) = torch.autograd.grad(ys[-1, 0], omega)
        assert_close(gradient.item(), -math.sin(2.0), rtol=0, atol=1e-6)


def test_adjoint_that_cannot_be_trusted_says_so():
    """y'' = -y - 40 y' decays at 40/s; backwards over 1 s the error grows by e^40."""

    def damped(t, y):
        return torch.stack((y[..., 1], -y[..., 0] - 40 * y[..., 1]), -1)

    with pytest.warns(UserWarning, match=r"adjoint cannot be trusted here: .* misses itself by"):
        integrate(damped, torch.tensor([1.0, 0]), T[[0, -1]], adjoint=True)


def test_scipy_cannot_cut_gradients_silently():
    with pytest.raises(ValueError, match="scipy_solver leaves torch"):
        integrate(oscillator(), torch.ones(2, requires_grad=True), T, method="scipy_solver")


def test_forward_mode_through_fixed_steps():
    """d cos(2)/d omega by torch.func.jvp through rk4."""

    def final(omega):
        return integrate(oscillator(omega), torch.tensor([1.0, 0]), T, method="rk4")[0][-1, 0]

    _, tangent = torch.func.jvp(final, (torch.tensor(2.0),), (torch.tensor(1.0),))
    assert_close(tangent.item(), -math.sin(2.0), rtol=0, atol=1e-7)
