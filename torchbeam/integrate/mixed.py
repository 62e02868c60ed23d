"""simulate for the mixed forms: block rate and minimal, explicit, behind torchdiffeq."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..checks import Value, as_tensor, increasing
from ..mixed import minimal
from ..mixed.algebra import mv
from ..mixed.chain import Chain, check_times
from ..mixed.consistent import at_rest, complete, consistent, drift, observe, rescaled
from ..mixed.rates import block_system, solve_scaled, sweep, terms
from ..mixed.state import MixedState, pack, unpack, unpack_minimal
from ..newton import FAILED
from ..scene import Scene
from ..solution import Energy, Solution, Stats
from .ode import ADAPTIVE, ADVICE, integrate, leaves, status_at

RESTART_FREE = (*ADAPTIVE, "euler", "midpoint", "heun2", "heun3", "rk4")  # methods that remember nothing from step to step


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
) -> Solution:
    """Integrate the mixed element's semi-discrete equations with any method of torchdiffeq.

    form     'block_rate' (24 N + 12 states, the index-reduced system) or 'minimal' (12 N states)
    initial  MixedState; its u, theta, V, Omega count, the rest is made consistent with the loads at t[0].
             None = undeformed and at rest in frame a
    inputs   of the scene by name: values (..., size) held throughout, or functions of t
    method, rtol, atol, options, adjoint: see `torchbeam.integrate.ode.integrate`
    project  block rate form: at every output set what the undifferentiated equations determine (F, M, accelerations, ends)
             from u, theta, V, Omega. Off by default: the form then shows its drift
    solver   block rate form: 'sweep' (O(N)) or 'dense' (torch.linalg.solve on the scaled block rate matrix)

    Rotations: at each output an element beyond |theta| = 6 (225 degrees) goes on in its other chart, see
    `mixed.consistent.rescaled`; steps end at the outputs for that. The Adams methods and scipy's keep a history, which
    this would cut: with them rotations stay in their first chart, good up to one turn.

    `stats.drift` (...): largest violation of the undifferentiated equations at an output (block rate form).

    Raises ValueError for what the form does not take; RuntimeError where every sample failed.
    """
    if form not in ("block_rate", "minimal"):
        raise ValueError(f"form = {form!r} was given; 'block_rate' or 'minimal' is wanted")
    if solver not in ("sweep", "dense"):
        raise ValueError(f"solver = {solver!r} was given; 'sweep' or 'dense' is wanted")
    if project and form == "minimal":
        raise ValueError("project=True was given for the minimal form; only 'block_rate' has something to project")
    if initial is not None and not isinstance(initial, MixedState):
        raise ValueError(f"initial of type {type(initial).__name__} was given; the mixed forms want a MixedState, "
                         "see consistent_state")
    if initial is not None and initial.u.shape[-2] != scene.beam.count:
        raise ValueError(f"initial with {initial.u.shape[-2]} elements was given; the beam has {scene.beam.count}")
    chain = Chain(scene, form, {} if inputs is None else inputs)
    t = increasing("t", as_tensor(t, scene.dtype, scene.device))
    check_times(chain, t)
    problem = (_BlockRate if form == "block_rate" else _Minimal)(chain, project, solver)

    start = at_rest(chain, t[0]) if initial is None else (initial.u, initial.theta, initial.V, initial.Omega)
    y0 = problem.start(t[0], *start)
    first = problem.rates(t[0], y0)
    y0 = y0.expand(torch.broadcast_shapes(y0.shape, first.shape))  # functions of t and inputs may bring batch axes
    ys, status, evaluations = integrate(
        problem.rates, y0, t, method=method, rtol=rtol, atol=atol, options=options, adjoint=adjoint,
        parameters=leaves(problem.rates(t[0], y0.detach())),
        after=problem.after if project or method in RESTART_FREE else None,
    )
    states = [problem.observe(*at) for at in zip(t, ys, status_at(ys, status.long()), strict=True)]
    state = MixedState.stack(states)
    reason = {FAILED: f"{method}: the step shrank to nothing, or the rates were not finite; {ADVICE}"}
    return Solution(
        t, state, _energy(chain, state),
        Stats(evaluations=evaluations, drift=problem.drift(t, ys), reason=reason if status.any() else {}),
    )


class _Minimal:
    """y = u, theta, V, Omega."""

    def __init__(self, chain: Chain, project: bool, solver: str) -> None:
        self.chain = chain

    def start(self, t: Tensor, *minimal_state: Tensor) -> Tensor:
        return pack(minimal_state)

    def rates(self, t: Tensor, y: Tensor) -> Tensor:
        return minimal.rates(self.chain, t, *unpack_minimal(y, self.chain.count))

    def after(self, t: Tensor, y: Tensor) -> Tensor:
        u, theta, V, Omega = unpack_minimal(y, self.chain.count)
        new = rescaled(self.chain, t, theta)
        return y if new is None else pack((u, new, V, Omega))

    def observe(self, t: Tensor, y: Tensor, status: Tensor) -> MixedState:
        return complete(self.chain, t, unpack_minimal(y, self.chain.count), status)

    def drift(self, t: Tensor, ys: Tensor) -> None:
        return None


class _BlockRate:
    """y = x, the twelve of `Fields`."""

    def __init__(self, chain: Chain, project: bool, solver: str) -> None:
        self.chain, self.project, self.dense = chain, project, solver == "dense"

    def start(self, t: Tensor, *minimal_state: Tensor) -> Tensor:
        x = consistent(self.chain, t, *minimal_state)
        return pack(x[:8], x[8:])

    def rates(self, t: Tensor, y: Tensor) -> Tensor:
        x = unpack(y, self.chain.count)
        s = terms(self.chain, t, x)
        return solve_scaled(*block_system(self.chain, x, s)) if self.dense else sweep(self.chain, x, s)

    def after(self, t: Tensor, y: Tensor) -> Tensor:
        x = unpack(y, self.chain.count)
        theta = rescaled(self.chain, t, x.theta)
        if theta is None and not self.project:
            return y
        moved = self.start(t, x.u, x.theta if theta is None else theta, x.V, x.Omega)
        if self.project:
            return moved
        return torch.where((theta != x.theta).any(-1).any(-1)[..., None], moved, y)

    def observe(self, t: Tensor, y: Tensor, status: Tensor) -> MixedState:
        x = unpack(y, self.chain.count)
        return observe(self.chain, t, x, mv(self.chain.S, torch.cat((x.F, x.M), -1)), status)

    def drift(self, t: Tensor, ys: Tensor) -> Tensor:
        here = [drift(self.chain, a, unpack(y, self.chain.count)) for a, y in zip(t, ys, strict=True)]
        return torch.stack(here).amax(0)


def _energy(chain: Chain, state: MixedState) -> Energy:
    """Kinetic sum h z.Mass z, strain sum h e.S^-1 e (2 h is the element's length); the loads' work is not integrated."""
    z = torch.cat((state.V, state.Omega), -1)
    kinetic, strain = ((chain.h * v * mv(matrix, v)).sum((-2, -1))
                       for v, matrix in ((z, chain.Mass), (state.strain, chain.K)))
    return Energy(kinetic, strain, None)
