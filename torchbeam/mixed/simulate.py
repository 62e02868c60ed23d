"""simulate for the mixed forms: block rate and minimal, explicit, behind torchdiffeq."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice
from ..core.status import FAILED
from ..core.validation import Value, as_tensor, increasing
from ..dynamics.torchdiffeq_bridge import ADAPTIVE, ADVICE, integrate, leaves
from ..math.shapes import broadcast_shapes
from ..scene.scene import Scene
from ..state.solution import Energy, Solution, Stats
from . import minimal
from .algebra import mv
from .consistent import at_rest, complete, consistent, consistent_state, drift, observe, rescaled
from .model import MixedModel, check_times
from .rates import block_system, solve_scaled, sweep, terms
from .state import MixedState, pack, unpack, unpack_minimal

# methods that remember nothing from step to step
RESTART_FREE = (*ADAPTIVE, "euler", "midpoint", "heun2", "heun3", "rk4")


def simulate_mixed(
    scene: Scene,
    t: Value,
    form: str,
    initial: MixedState | None = None,
    method: str = "dopri5",
    inputs: dict[str, Any] | None = None,
    *,
    rtol: float = 1e-6,
    atol: float = 1e-8,
    options: dict[str, Any] | None = None,
    adjoint: bool = False,
    project: bool = False,
    solver: str = "sweep",
    begin: Tensor | None = None,
) -> Solution:
    """Integrate the mixed element's semi-discrete equations with any method of torchdiffeq.

    form     'block_rate' (24 N + 12 states, the index-reduced system) or 'minimal' (12 N states)
    initial  MixedState; its u, theta, V, Omega count, the rest is made consistent with the loads at
             t[0]. None = undeformed and at rest in frame a
    inputs   of the scene by name: values (..., size) held throughout, or functions of t
    method, rtol, atol, options, adjoint: see `torchbeam.dynamics.torchdiffeq_bridge.integrate`
    project  block rate form: at every output set what the undifferentiated equations determine (F,
             M, accelerations, ends) from u, theta, V, Omega. Off by default: the form then shows
             its drift
    begin    (...) s, the instant of each sample from which t counts; None = t is that of all
    solver   block rate form: 'sweep' (O(N)) or 'dense' (torch.linalg.solve on the scaled block rate
             matrix)

    Rotations: at each output an element beyond |theta| = 6 (225 degrees) goes on in its other
    chart, see `mixed.consistent.rescaled`; steps end at the outputs for that. The Adams methods and
    scipy's keep a history, which this would cut: with them rotations stay in their first chart,
    good up to one turn.

    `stats.drift` (...): largest violation of the undifferentiated equations at an output
    (block rate form).

    Raises ValueError for what the form does not take; RuntimeError where every sample failed.
    """
    _check(scene, form, initial, project, solver)
    model = MixedModel(scene, form, {} if inputs is None else inputs)
    t = increasing("t", as_tensor(t, scene.dtype, scene.device))
    instants = t if begin is None else [begin + now for now in t]
    check_times(model, t if begin is None else torch.stack((begin.min(), begin.max() + t[-1])))
    problem = (_BlockRate if form == "block_rate" else _Minimal)(model, project, solver)

    def at(function: Callable[[Tensor, Tensor], Tensor]) -> Callable[[Tensor, Tensor], Tensor]:
        return function if begin is None else lambda now, y: function(begin + now, y)

    first = instants[0]
    start = (
        at_rest(model, first)
        if initial is None
        else (initial.u, initial.theta, initial.V, initial.Omega)
    )
    y0 = problem.start(first, *start)
    wide = problem.rates(first, y0).shape  # functions of t and inputs may bring batch axes
    instant_axes = () if begin is None else (*begin.shape, 1)  # as may instants
    y0 = y0.expand(broadcast_shapes(y0.shape, wide, instant_axes))
    ys, status, evaluations = integrate(
        at(problem.rates),
        y0,
        t,
        method=method,
        rtol=rtol,
        atol=atol,
        options=options,
        adjoint=adjoint,
        parameters=leaves(at(problem.rates), y0.detach(), t, adjoint),
        after=at(problem.after) if project or method in RESTART_FREE else None,
    )
    states = [problem.observe(*point) for point in zip(instants, ys, status, strict=True)]
    state = MixedState.stack(states)
    why = f"{method}: the step shrank to nothing, or the rates were not finite; {ADVICE}"
    reason, off = {FAILED: why} if status.any() else {}, problem.drift(instants, ys)
    stats = Stats(evaluations=evaluations, drift=off, reason=reason, engine="eager")
    return Solution(t, state, _energy(model, state), stats)


def _check(scene: Scene, form: str, initial: Any, project: bool, solver: str) -> None:
    """ValueError for what a form does not take."""
    choice("form", form, ("block_rate", "minimal"))
    choice("solver", solver, ("sweep", "dense"))
    if boolean("project", project) and form == "minimal":
        raise ValueError(
            "project=True was given for the minimal form; only 'block_rate' has something to "
            "project"
        )
    if initial is not None and not isinstance(initial, MixedState):
        raise ValueError(
            f"initial of type {type(initial).__name__} was given; the mixed forms want a "
            "MixedState, see consistent_state"
        )
    if initial is not None and initial.u.shape[-2] != scene.beam.station_count:
        raise ValueError(
            f"initial with {initial.u.shape[-2]} elements was given; the beam has "
            f"{scene.beam.station_count}"
        )


def rest(scene: Scene, form: str, shape: tuple[int, ...]) -> MixedState:
    """A batch of beams of this shape, undeformed and at rest under inputs of zero."""
    still = torch.zeros(*shape, scene.beam.station_count, 3, dtype=scene.dtype).to(scene.device)
    zero = {name: still.new_zeros(*shape, size) for name, size in scene.inputs.items()}
    return consistent_state(scene, u=still, form=form, inputs=zero)


def state_size(scene: Scene, form: str) -> int:
    """Numbers in a state of a form; ValueError for a scene that the form does not take."""
    inputs = {name: torch.zeros(size) for name, size in scene.inputs.items()}
    count = MixedModel(scene, form, inputs).count
    return 12 * count if form == "minimal" else 24 * count + 12


class _Minimal:
    """y = u, theta, V, Omega."""

    def __init__(self, model: MixedModel, project: bool, solver: str) -> None:
        self.model = model

    def start(self, t: Tensor, *minimal_state: Tensor) -> Tensor:
        return pack(minimal_state)

    def rates(self, t: Tensor, y: Tensor) -> Tensor:
        return minimal.rates(self.model, t, *unpack_minimal(y, self.model.count))

    def after(self, t: Tensor, y: Tensor) -> Tensor:
        u, theta, V, Omega = unpack_minimal(y, self.model.count)
        new = rescaled(self.model, t, theta)
        return y if new is None else pack((u, new, V, Omega))

    def observe(self, t: Tensor, y: Tensor, status: Tensor) -> MixedState:
        return complete(self.model, t, unpack_minimal(y, self.model.count), status)

    def drift(self, t: Tensor, ys: Tensor) -> None:
        return None


class _BlockRate:
    """y = x, the twelve of `Fields`."""

    def __init__(self, model: MixedModel, project: bool, solver: str) -> None:
        self.model, self.project, self.dense = model, project, solver == "dense"

    def start(self, t: Tensor, *minimal_state: Tensor) -> Tensor:
        x = consistent(self.model, t, *minimal_state)
        return pack(x[:8], x[8:])

    def rates(self, t: Tensor, y: Tensor) -> Tensor:
        x = unpack(y, self.model.count)
        s = terms(self.model, t, x)
        return (
            solve_scaled(*block_system(self.model, x, s)) if self.dense else sweep(self.model, x, s)
        )

    def after(self, t: Tensor, y: Tensor) -> Tensor:
        x = unpack(y, self.model.count)
        theta = rescaled(self.model, t, x.theta)
        if theta is None and not self.project:
            return y
        moved = self.start(t, x.u, x.theta if theta is None else theta, x.V, x.Omega)
        if self.project:
            return moved
        return torch.where((theta != x.theta).any(-1).any(-1)[..., None], moved, y)

    def observe(self, t: Tensor, y: Tensor, status: Tensor) -> MixedState:
        x = unpack(y, self.model.count)
        return observe(self.model, t, x, mv(self.model.S, torch.cat((x.F, x.M), -1)), status)

    def drift(self, t: Tensor, ys: Tensor) -> Tensor:
        here = [
            drift(self.model, a, unpack(y, self.model.count)) for a, y in zip(t, ys, strict=True)
        ]
        return torch.stack(here).amax(0)


def _energy(model: MixedModel, state: MixedState) -> Energy:
    """Kinetic sum h z.Mass z, strain sum h e.S^-1 e; the loads' work is not integrated."""
    z = torch.cat((state.V, state.Omega), -1)
    kinetic, strain = (
        (model.h * v * mv(matrix, v)).sum((-2, -1))
        for v, matrix in ((z, model.Mass), (state.strain, model.K))
    )
    return Energy(kinetic, strain, None)
