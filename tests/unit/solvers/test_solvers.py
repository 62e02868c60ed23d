"""Newton's method and the implicit function theorem: what they ask of a problem, beams or not, and
that neither disturbs the other.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.core.derivatives import cached, no_derivatives
from torchbeam.core.leaves import Tree, leaf
from torchbeam.core.status import SUCCESS
from torchbeam.equations.generalized_alpha import GeneralizedAlphaProblem
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.equations.steady import Configuration, SteadyProblem
from torchbeam.nodal.discretise import discretise
from torchbeam.solvers.implicit_gradient import differentiated, implicit_gradient
from torchbeam.solvers.newton import first_wait, newton, step_length

SOFT = dict(EA=4e3, GA=2e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)


class Root(NamedTuple):
    x: Tensor


class Square(NamedTuple):
    nodes: Tensor
    strain: Tensor

    def measure(self):
        return self.nodes.detach().abs()[..., 0, 0]


class Slope(NamedTuple):
    slope: Tensor
    exact: Tensor = torch.tensor(True)

    def solve(self, nodes, strain):
        return -nodes / self.slope, nodes

    def detach(self):
        return Slope(self.slope.detach())


@dataclass(frozen=True)
class SquareRoot(Tree):
    """x^2 = e^a, the least that Newton's method takes."""

    a: Tensor = leaf(0)

    @cached
    def square(self) -> Tensor:
        return self.a.exp()[..., None, None]

    def residual(self, x):
        return Square(x.x**2 - self.square, 0 * x.x), x.x

    def linearise(self, x, about):
        return Slope(2 * about)

    def update(self, x, change):
        return Root(x.x + change)

    def merit(self, residual):
        return None

    told, patient = None, False

    def telling(self, *about):
        return {}


class Whole:
    """The same, not a tree."""

    def __init__(self, a):
        self.inner = SquareRoot(a)
        for name in ("residual", "linearise", "update", "merit", "telling"):
            setattr(self, name, getattr(self.inner, name))


@pytest.mark.parametrize("kind", (SquareRoot, Whole))
def test_a_problem_is_what_the_protocol_says(kind):
    """100 square roots, most of them next to the guess: those that go on do so as a problem of
    their own, if there is one.
    """
    a = torch.cat((torch.full((90,), 1e-3), torch.linspace(3.0, 9.0, 10)))
    x, _, status, iterations = newton(kind(a), Root(torch.ones(100, 1, 1)), tolerance=1e-12)
    assert (status == SUCCESS).all() and iterations[0] < iterations[-1]
    assert_close(x.x[:, 0, 0], (a / 2).exp(), rtol=1e-13, atol=0)


@dataclass(frozen=True)
class Stiff(SquareRoot):
    """With a tangent that is 1 % too steep: the residual falls a hundredfold at most with each
    update, never quadratically.
    """

    def linearise(self, x, about):
        return Slope(2.02 * about, torch.tensor(False))


@dataclass(frozen=True)
class Arctangent(SquareRoot):
    """arctan x = 0, which whole steps lead ever farther from where |x| is above 1.39."""

    def residual(self, x):
        return Square(torch.atan(x.x), 0 * x.x), x.x

    def linearise(self, x, about):
        return Slope(1 / (1 + about**2))


class Searched(Arctangent):
    """With its square as the merit."""

    def merit(self, residual):
        return residual.measure().square()

    def near(self, x):
        return torch.ones_like(x.x[..., 0, 0], dtype=torch.bool)

    def between(self, last, x, share):
        return Root(torch.lerp(last.x, x.x, share[..., None, None]))


class Far(Searched):
    """Where nothing is near enough to touch."""

    def near(self, x):
        return ~super().near(x)


class Misled(Searched):
    """With a merit that rises where the residual falls."""

    def merit(self, residual):
        return 1 / residual.measure()


def test_steps_are_shortened_where_they_raise_the_merit():
    """From 30, where the first whole step leads to -1400: by itself, and among samples that are
    soon done. Each evaluation counts, of which Newton's method takes about two a step.
    """
    start = torch.cat((torch.full((90,), 1e-3), torch.linspace(1.0, 30.0, 10)))
    whole, searched = (
        newton(kind(0 * start), Root(start[:, None, None])) for kind in (Arctangent, Searched)
    )
    assert (whole.status[-8:] != SUCCESS).all()
    assert (searched.status == SUCCESS).all() and searched.x.x.abs().max() < 1e-8
    alone = newton(Searched(0 * start[-1]), Root(start[-1, None, None]))
    assert_close(alone.x.x, searched.x.x[-1], rtol=0, atol=0)
    assert alone.iterations == searched.iterations[-1] <= 25


@pytest.mark.parametrize("patient", (True, False))
def test_how_long_whole_steps_may_lead_above_the_best(patient):
    """With patience five do; then it is gone back to the best, and the step from there shortened,
    as the first one is without.
    """
    one = torch.ones(())
    share, waited, free = one, first_wait(patient) * one, torch.ones((), dtype=torch.bool)
    best, ratios = one, []
    for merit in (1.0, *[4.0] * 6, 1.0, 4.0):
        length = step_length(merit * one, best, share, waited, free, patient)
        best, share, waited = length.merit, length.share, length.waited
        ratios.append(float(length.ratio))
    want = [*[1] * 6, 0, 1, 0.2] if patient else [1, *[0.2] * 3, *[1] * 4, 0.2]
    assert ratios == pytest.approx(want)


def test_steps_are_whole_where_nothing_is_near_enough_to_touch():
    """The same as without a merit: from 1.3, and from 30, which fails."""
    start = Root(torch.tensor([1.3, 30.0])[:, None, None])
    whole, far = (newton(kind(0 * start.x[:, 0, 0]), start) for kind in (Arctangent, Far))
    for a, b in zip((*whole.x, *whole[1:]), (*far.x, *far[1:]), strict=True):
        assert_close(a, b, rtol=0, atol=0, equal_nan=True)


def test_a_step_that_is_foreseen_to_converge_is_not_taken_back():
    """Whatever the merit says: the root is what is returned as one."""
    start = torch.full((1, 1, 1), 0.01)
    found = newton(Misled(0 * start[..., 0, 0]), Root(start))
    assert found.status == SUCCESS and found.x.x.abs() < 1e-12


def test_an_inexact_tangent_is_not_trusted_to_converge_quadratically():
    """Once two residuals tell how fast it falls, the next is foreseen; what was asked for is
    reached.
    """
    problem = Stiff(torch.linspace(-1, 1, 50))
    x, _, status, _ = newton(problem, Root(torch.ones(50, 1, 1)), tolerance=1e-9)
    assert (status == SUCCESS).all()
    assert problem.residual(x)[0].measure().max() <= 1.01e-9


def test_where_nothing_is_foreseen_a_residual_below_the_tolerance_is_measured():
    """In every other sample: one iteration more, which leaves a hundredth of the tolerance."""
    problem, start = Stiff(torch.linspace(-1, 1, 50)), Root(torch.ones(50, 1, 1))
    measured = torch.arange(50) % 2 == 0
    usual = newton(problem, start, tolerance=1e-9)
    found = newton(problem, start, tolerance=1e-9, foresee=~measured)
    assert (found.status == SUCCESS).all()
    assert (found.iterations == usual.iterations + measured).all()
    left = problem.residual(found.x)[0].measure()
    assert (
        left[measured].max()
        <= 1.01e-11
        < 1e-10
        < problem.residual(usual.x)[0].measure()[measured].max()
    )


def test_what_newton_has_cached_is_not_differentiated():
    """The same problem solved without derivatives and differentiated: dx/da = x/2, whatever was
    asked for first.
    """
    a = torch.tensor([0.3, 1.0], requires_grad=True)
    problem = SquareRoot(a)
    x, _, status, _ = newton(problem, Root(torch.ones(2, 1, 1)), tolerance=1e-12)
    assert differentiated(problem, x)
    x, _ = implicit_gradient(problem, x, status == SUCCESS)
    (slope,) = torch.autograd.grad(x.x.sum(), a)
    assert_close(slope, (a / 2).exp() / 2, rtol=1e-12, atol=0)


def problems():
    """Of each kind, from tensors that enter by what is cached."""
    curvature = torch.tensor([0.0, 0.3, 0.1], requires_grad=True)
    omega = torch.tensor([0.0, 0.0, 0.7], requires_grad=True)
    bent = tb.Scene(
        tb.Beam.straight(1.0, 2, tb.Section.from_stiffness(**SOFT)),
        [tb.Actuation(curvature=curvature)],
        frame=tb.Frame(angular_velocity=omega),
    )
    still = replace(bent, frame=None)
    dt = torch.tensor(0.01, requires_grad=True)
    yield SteadyProblem(discretise(bent), torch.tensor(0.0), {}, torch.ones(())), (curvature, omega)
    for scene, kind in ((bent, MidpointProblem), (still, GeneralizedAlphaProblem)):
        stepper = tb.Stepper(
            scene, 0.01, "midpoint" if kind is MidpointProblem else "generalized_alpha"
        )
        start = stepper.model.space.to_reduced(stepper.begin(tb.rest(scene)))
        yield (
            kind(stepper.model, start, dt, torch.tensor(0.0), {}),
            (curvature, dt, *((omega,) if scene is bent else ())),
        )


@pytest.mark.parametrize("number", range(3))
def test_a_problem_has_its_derivatives_whatever_was_asked_without_them(number):
    """Residual and tangent without derivatives first, on the very same object: the residual's
    gradient afterwards is that of a fresh one, to the bit.
    """
    gradients = []
    for first in (False, True):
        problem, tensors = list(problems())[number]
        start = problem.model.space.start(tb.rest(problem.model.scene))
        with no_derivatives():
            x = Configuration(start.position, start.rotation, start.stress)
            x = x if number == 0 else list(problems())[number][0].predictor()
            if first:
                problem.linearise(x, *problem.residual(x)[1:])
        residual = problem.residual(x)[0]
        weights = torch.linspace(1, 2, residual.nodes.numel()).view_as(residual.nodes)
        total = (
            (weights * residual.nodes).sum()
            + residual.strain.square().sum()
            + residual.strain.sum()
        )
        gradients.append(torch.autograd.grad(total, tensors))
    assert all(x.abs().max() > 0 for x in gradients[0])
    assert_close(gradients[1], gradients[0], rtol=0, atol=0)
