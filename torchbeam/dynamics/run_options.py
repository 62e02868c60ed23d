"""Options of runs: how long steps are, and what makes them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypedDict

from torch import Tensor


class StepOptions(TypedDict, total=False):
    """Of implicit methods, whose steps have a given length or, with `rtol` or `atol`, are adaptive.

    Args:
        step: s, of implicit methods; each interval of t is split into ceil(interval/step) equal
            steps. None: the shortest interval, or 1/200 of the whole, whichever is less.
        rtol, atol: of implicit methods: adaptive steps (see `torchbeam.dynamics.adaptive`). The
            largest error of a position over the run is to be at most atol m + rtol times the length
            of the beam, that of a rotation rtol + atol/length rad (see `Tolerance`; measured on
            positions; rotations in undamped twist were off by up to 4.1 of it); numbers, or (...).
            Of torchdiffeq's: numbers, None = 1e-6 and 1e-8.
        events: with adaptive steps: a function of the state that gives one number (...) a sample,
            of that sample alone, or a list of such: a sample stops where one crosses zero, and
            `sol.event` says which, when and how.
        max_steps: adaptive steps in a run, at most.
        first_step: s, of adaptive steps; None = found by a trial.
        engine, lumped, conserve, rho_inf, tolerance, iterations, halvings: of implicit methods, see
            `Stepper`.
        checkpoint: keep the graph at sqrt(steps) instants and compute the rest again in backward:
            long horizons then fit in memory, for one more forward. Nothing under
            torch.autograd.forward_ad, whose derivatives go forward with the steps: they are right,
            and need no memory of the past.
        progress: called with (steps done, steps in all) after each step of a given length.
    """

    step: float | None
    rtol: Any
    atol: Any
    events: Any
    max_steps: int
    first_step: float | None
    engine: str
    lumped: bool
    conserve: bool
    rho_inf: float | None
    tolerance: float | None
    iterations: int
    halvings: int
    checkpoint: bool
    progress: Callable[[int, int], None] | None


class IntegratorOptions(TypedDict, total=False):
    """Of torchdiffeq's methods.

    Args:
        options, adjoint: of torchdiffeq's methods, see
            `torchbeam.dynamics.torchdiffeq_bridge.integrate`.
        begin: of torchdiffeq's methods: (...) s, the instant of each sample from which t counts;
            None = t is that of all.
        project, solver: of the form "block_rate", see
            `torchbeam.mixed.simulate.simulate_mixed`.
    """

    options: dict[str, Any] | None
    adjoint: bool
    begin: Tensor | None
    project: bool
    solver: str
