"""Method: what a step of an implicit method is made of, and what it takes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from ..core.arguments import boolean
from ..engine.chain.compiled_step import EXTRAPOLATION
from ..equations.midpoint import MidpointProblem
from ..equations.step_problem import StepProblem
from ..nodal.model import Model
from ..state.state import State, plain


class Composition(NamedTuple):
    """Solves one after the other: `shares` of the step that each makes, their sum 1; one that is
    negative goes back in time.
    """

    fractions: tuple[float, ...]

    @property
    def begins(self) -> tuple[float, ...]:
        """Where each begins, as a share of the step."""
        return tuple(sum(self.fractions[:k]) for k in range(len(self.fractions)))

    def instants(self, part: float) -> tuple[float, ...]:
        """Where each takes loads and inputs, this part having passed, as a share of the step."""
        return tuple(
            begin + part * share for begin, share in zip(self.begins, self.fractions, strict=True)
        )


WHOLE = Composition((1.0,))


class Scheme(NamedTuple):
    """A step as the mean of compositions that all start where it does, by `weights` of sum 1."""

    compositions: tuple[Composition, ...] = (WHOLE,)
    weights: tuple[float, ...] = (1.0,)

    @property
    def fractions(self) -> tuple[float, ...]:
        """Of all solves, one composition after the other."""
        return tuple(part for composition in self.compositions for part in composition.fractions)

    @property
    def weights_of_solves(self) -> tuple[float, ...]:
        """Those of the compositions that they belong to."""
        pairs = zip(self.compositions, self.weights, strict=True)
        return tuple(weight for composition, weight in pairs for _ in composition.fractions)

    @property
    def solves(self) -> int:
        return len(self.fractions)

    def instants(self, part: float) -> tuple[float, ...]:
        """Of all solves, one composition after the other."""
        return tuple(at for composition in self.compositions for at in composition.instants(part))


class Method:
    """An implicit method, with its options: one solve of `problem` a step, unless it says
    otherwise.

    SOLVES   the method whose step a solve is
    ORDER    of accuracy in time, see `order`;  SOLVES_A_STEP: at most
    INSTANT  of a solve: where, as a share of it, loads and inputs are taken
    PART     of a solve's rotation: what the unknown holds
    """

    PROBLEM: ClassVar[type[StepProblem]] = MidpointProblem
    WHOLE: ClassVar[Scheme] = Scheme()
    SOLVES: ClassVar[str] = "midpoint"
    ORDER: ClassVar[int] = 2
    SOLVES_A_STEP: ClassVar[int] = 1

    def __init__(self, **options: Any) -> None:
        self.options = options
        self.INSTANT, self.PART = self.PROBLEM.INSTANT, self.PROBLEM.PART

    @classmethod
    def of(cls, name: str, conserve: bool, rho_inf: float | None) -> Method:
        """The method of that name, by a user's options. Raises ValueError for one it has not."""
        raise NotImplementedError

    @property
    def solves(self) -> tuple[str, dict[str, Any]]:
        """Name of the method whose step a solve is, and its options: what engines are asked for."""
        return self.SOLVES, {
            name: value for name, value in self.options.items() if value is not False
        }

    def check(self, model: Model) -> None:
        """Raises ValueError for a model that the method does not take."""

    def problem(self, *args: Any) -> StepProblem:
        """One solve: model, state, dt, t, inputs."""
        return self.PROBLEM(*args, **self.options)

    def order(self, model: Model) -> int:
        """Of accuracy in time, of a model: first where friction is taken at the end of the step."""
        return 1 if any(x.has_friction for x in model.interactions) else self.ORDER

    def schemes(self, model: Model, dt: Tensor) -> list[tuple[Scheme, Tensor | None]]:
        """Schemes of a step of dt, with the samples (...) bool that each makes; None = all."""
        return [(self.WHOLE, None)]

    def longest(self, model: Model) -> Tensor | None:
        """Length (...) s of the longest step that the method takes of a model; None = any."""
        return None

    def alone(self, model: Model, dt: Tensor) -> Scheme | None:
        """The one scheme that a step of dt, or steps of dt (K, ...), are made by, of all samples;
        None where there are more.
        """
        schemes = self.schemes(model, dt)
        return schemes[0][0] if len(schemes) == 1 else None

    def stress_at(self, model: Model, dt: Tensor) -> Tensor | float:
        """Share (...) of a step of dt (...) at which its stress is: the last solve's middle."""
        place: Tensor | float = 0.5
        for scheme, samples in self.schemes(model, dt):
            last = scheme.compositions[-1]
            at = last.begins[-1] + last.fractions[-1] / 2
            place = at if samples is None else torch.where(samples, at, place)
        return place

    def begin(
        self, state: State, model: Model, dt: Tensor, trial: Callable[[State], State]
    ) -> State:
        """`state` with what the method remembers; trial(state): the state a midpoint step later."""
        return state if type(state) is State else plain(state)


class Midpoint(Method):
    """See `midpoint`."""

    @classmethod
    def of(cls, name: str, conserve: bool, rho_inf: float | None) -> Midpoint:
        without_rho(name, rho_inf)
        return cls(conserve=boolean("conserve", conserve))

    def check(self, model: Model) -> None:
        if self.options["conserve"] and model.scene.has_prescribed_motion:
            raise ValueError(
                "conserve with a frame or support that moves was given; what holds the beam "
                "still is wanted"
            )


class Extrapolation(Midpoint):
    """Solves of midpoint steps, whose ends are mixed."""

    SOLVES = EXTRAPOLATION


def without_rho(name: str, rho_inf: float | None) -> None:
    if rho_inf is not None:
        raise ValueError(f"rho_inf was given; {name!r} has none (generalized_alpha has)")
