"""Explicit integration behind torchdiffeq: its methods, max-norm control, an honest account of
failed samples.
"""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, tolerance
from ..core.arguments import options as check_options
from ..core.status import FAILED, named
from ..core.validation import broadcast, increasing, refusal
from ..core.warning import warn

# torchdiffeq's names; it is imported where it is first used: with it comes scipy, which takes
# longer to import than torchbeam itself
ADAPTIVE = ("dopri8", "dopri5", "bosh3", "fehlberg2", "adaptive_heun")
FIXED = ("euler", "midpoint", "heun2", "heun3", "rk4", "explicit_adams", "implicit_adams")
METHODS = (*ADAPTIVE, *FIXED, "fixed_adams", "scipy_solver")
ADVICE = "try the implicit method 'midpoint' of the nodal form, a shorter step, or other tolerances"
INSTANTS = 33  # beside those asked for, at which what rates read is looked for
# largest relative error of the state reconstructed backwards that a continuous adjoint may carry
TRUSTED = 1e-3

Rates = Callable[[Tensor, Tensor], Tensor]
Hook = Callable[[Tensor, Tensor], Tensor]


class AllFailed(RuntimeError):
    """Error: every sample has failed, or the one that has cannot be found."""


def integrate(
    rhs: Rates,
    y0: Tensor,
    t: Tensor,
    *,
    method: str = "dopri5",
    rtol: float = 1e-6,
    atol: float = 1e-8,
    options: dict[str, Any] | None = None,
    adjoint: bool = False,
    parameters: tuple[Tensor, ...] = (),
    after: Hook | None = None,
) -> tuple[Tensor, Tensor, int]:
    """Solve dy/dt = rhs(t, y) from y(t[0]) = y0 with torchdiffeq; every sample is a row of y.

    rhs         (t, y (..., n)) -> (..., n); rows do not know each other
    y0          (..., n);  t (T,) s, strictly increasing
    method      a name of torchdiffeq; rtol, atol and options go to it unchanged, but for the error
                norm: an adaptive method controls the *largest* entry (torchdiffeq's root mean
                square lets a batch hide a bad sample). Outputs inside a step are interpolated by
                torchdiffeq with a quartic, whatever the method's order; options={"step_t": t[1:]}
                ends a step at each of them. Of methods with fixed steps they are on straight lines,
                of second order, unless the step divides the intervals; options={"interp": "cubic"}
                is of fourth
    adjoint     gradients by the continuous adjoint with respect to y0 and `parameters` instead of
                through the steps; the state is integrated back over each output interval, as the
                adjoint does, and compared
    parameters  every tensor that rhs reads and whose gradient may be wanted
    after       (t, y) -> y, applied at each output before going on from it: rescaling, projection,
                normalising. Steps then end at the outputs.

    Returns ys (T, ..., n); status (T, ...), 0 = success and, behind the last good output,
    3 = failed: rates that are not finite or a step that shrank to nothing. A failed sample keeps
    that output, and all that it has are constants: no gradient passes through it. The others are
    solved as if it were not there, and their gradients are those without it. evaluations: calls of
    rhs.

    Raises ValueError for an unknown method or option or a t that does not increase; AllFailed where
    every sample failed, or where the sample that stopped the solver cannot be found. Warns
    (RuntimeWarning) about samples that failed, and (UserWarning) where the adjoint cannot be
    trusted.
    """
    if method not in METHODS:
        raise ValueError(f"method = {method!r} was given; torchdiffeq has {', '.join(METHODS)}")
    increasing("t", t)
    boolean("adjoint", adjoint)
    if options is not None and not isinstance(options, dict):
        raise refusal(f"options of type {type(options).__name__}", "a dictionary of torchdiffeq's")
    check_options(f"torchdiffeq's {method!r}", options or {}, known_options(method))
    for name, value in dict(rtol=rtol, atol=atol).items():
        broadcast(
            f"{name} and a state",
            torch.as_tensor(tolerance(name, value, zero=True)).shape,
            y0.shape,
        )
    if method == "scipy_solver" and not adjoint and torch.is_grad_enabled():
        if any(p.requires_grad for p in (y0, *parameters)):
            raise ValueError(
                "scipy_solver leaves torch and has no gradient; adjoint=True or another method "
                "has one"
            )

    solve = _Solve(
        rhs, y0, method, dict(rtol=rtol, atol=atol), dict(options or {}), adjoint, parameters, after
    )
    ys, status = _solved(solve, t)
    if adjoint:
        _check_reconstruction(solve, ys, t)
    return ys, status.view(len(t), *y0.shape[:-1]), solve.evaluations


def _solved(solve: _Solve, t: Tensor) -> tuple[Tensor, Tensor]:
    """ys (T, ..., n) and status (T, samples), see `integrate`, without each sample that failed."""
    y0, method = solve.y0, solve.method
    good: dict[int, Tensor] = {}  # failed sample -> its outputs, held from the failure on
    status = torch.zeros(len(t), y0.shape[:-1].numel(), dtype=torch.long, device=y0.device)
    while True:
        ys, failure = solve.run(t)
        if failure is None:
            break
        k, rows = failure
        sentence = _sentence(method, rows, t[k], y0.shape[:-1])
        if not rows.any():
            raise AllFailed(sentence)
        if ys is None:  # stopped inside an interval: the outputs before it are good
            ys = solve.run(t[: k + 1])[0] if k else y0[None]
        for row in rows.flatten().nonzero().flatten().tolist():
            held = ys[: k + 1].reshape(k + 1, -1, y0.shape[-1])[:, row].detach()
            good[row] = torch.cat((held, held[-1:].expand(len(t) - 1 - k, -1)))
            status[k + 1 :, row] = FAILED
        solve.dead = solve.dead | rows
        if solve.dead.all():
            raise AllFailed(sentence)
        warn(sentence)
    if good:
        flat = ys.reshape(len(t), -1, y0.shape[-1])
        each = [good.get(row, flat[:, row]) for row in range(flat.shape[1])]
        ys = torch.stack(each, 1).view_as(ys)
    return ys, status


def leaves(rhs: Rates, y: Tensor, t: Tensor, throughout: bool) -> tuple[Tensor, ...]:
    """The leaf tensors with gradient that rates at y are computed from: what the scene, its
    functions and its inputs hold. Those at t[0]; or `throughout` the time, where functions of t may
    read other ones later.
    """
    instants = t.detach()[:1]
    if throughout:
        share = torch.linspace(0, 1, INSTANTS, dtype=t.dtype, device=t.device)
        instants = torch.cat((t.detach(), t.detach()[0] + share * (t.detach()[-1] - t.detach()[0])))
    tensors: dict[int, Tensor] = {}
    for now in instants:  # one after the other, as a graph is large
        seen, todo = set(), [rhs(now, y).grad_fn]
        while todo:
            node = todo.pop()
            if node is None or node in seen:
                continue
            seen.add(node)
            if hasattr(node, "variable"):
                tensors[id(node.variable)] = node.variable
            todo.extend(parent for parent, _ in node.next_functions)
    return tuple(tensors.values())


def known_options(method: str) -> list[str]:
    """Names that torchdiffeq's solver takes in `options`; any other it would only warn of."""
    from torchdiffeq._impl.odeint import SOLVERS  # it has no public table

    inits = [
        vars(kind)["__init__"] for kind in SOLVERS[method].__mro__[:-1] if "__init__" in vars(kind)
    ]
    names = {
        p.name
        for init in inits
        for p in inspect.signature(init).parameters.values()
        if p.kind is not p.VAR_KEYWORD
    }
    return sorted(names - {"self", "func", "y0", "rtol", "atol"})


class _Solve:
    """One integration: what torchdiffeq calls, and what tells which sample has stopped it."""

    def __init__(self, rhs, y0, method, tolerances, options, adjoint, parameters, after) -> None:
        from torchdiffeq import odeint, odeint_adjoint

        self.rhs, self.y0, self.method = rhs, y0, method
        self.after, self.tolerances = after, tolerances
        self.adaptive = method in ADAPTIVE
        self.options = options
        if self.adaptive:
            self.norm = options.get("norm", _largest)
            self.options = {**options, "norm": self._norm}
            self.callback_step = self._before_step  # torchdiffeq looks for it by this name
        adjoint_options = dict(adjoint_params=tuple(parameters)) if adjoint else {}
        self.odeint = odeint_adjoint if adjoint else odeint
        self.arguments = {**tolerances, "method": method, **adjoint_options}
        self.hold = torch.nan_to_num(y0.detach())  # where failed samples rest
        self.dead = torch.zeros(y0.shape[:-1], dtype=torch.bool, device=y0.device)
        self.evaluations = 0
        self.time = self.step = self.ratio = None

    def __call__(self, t: Tensor, y: Tensor) -> Tensor:
        self.evaluations += 1
        if not self.dead.any():
            return self.rhs(t, y)
        return torch.where(self.dead[..., None], torch.zeros_like(y), self.rhs(t, self._resting(y)))

    def _resting(self, y: Tensor) -> Tensor:
        return torch.where(self.dead[..., None], self.hold, y)

    def run(self, t: Tensor) -> tuple[Tensor | None, tuple[int, Tensor] | None]:
        """Outputs at t, and None or the failure: the last good output's index and the samples (...)
        at fault. Without outputs the solver stopped inside the interval after that index.
        """
        self.time, self.step, self.ratio = t[0], None, None
        try:
            y0 = self._resting(self.y0)
            ys = self._segment(t, y0) if self.after is None else self._stepwise(t, y0)
        except AssertionError:
            # torchdiffeq's 'underflow in dt', 'non-finite values', 'max_num_steps exceeded'
            return None, (int((t <= self.time.to(t)).sum()) - 1, self._culprits())
        bad = ~torch.isfinite(ys.detach()).all(-1) & ~self.dead
        if bad.any():
            first = int(bad.reshape(len(ys), -1).any(1).nonzero()[0, 0])
            return ys, (max(first - 1, 0), bad[first])
        if len(ys) < len(t):  # scipy's solver gives up by returning fewer outputs
            return ys, (len(ys) - 1, self._culprits())
        return ys, None

    def _stepwise(self, t: Tensor, y0: Tensor) -> Tensor:
        ys = [y0]
        for a, b in itertools.pairwise(t):
            ys.append(self.after(b, self._segment(torch.stack((a, b)), ys[-1])[-1]))
        return torch.stack(ys)

    def _segment(self, t: Tensor, y: Tensor) -> Tensor:
        options = self.options
        # end a step at the output, and go on with the step size reached
        if self.adaptive and self.after is not None:
            jumps, stops = (
                set(torch.as_tensor(options.get(name, ()), dtype=torch.float64).tolist())
                for name in ("jump_t", "step_t")
            )
            stops = {*stops, t[-1].item()} - jumps
            options = {
                **options,
                "step_t": torch.tensor(sorted(stops), dtype=torch.float64, device=t.device),
            }
            if self.step is not None:
                options["first_step"] = self.step
        return self.odeint(self, y, t, options=options, **self.arguments)

    def _before_step(self, t: Tensor, y: Tensor, step: Tensor) -> None:
        self.time, self.step = t.detach(), step.detach()

    def _norm(self, ratio: Tensor) -> Tensor:
        self.ratio = ratio.detach() if isinstance(ratio, Tensor) else None
        return self.norm(ratio)

    @torch.no_grad()
    def _culprits(self) -> Tensor:
        """Samples (...) whose rates or error estimate are not finite; else those whose error is
        above the tolerance.
        """
        start = ~torch.isfinite(self.rhs(self.time.to(self.y0), self.y0)).all(-1)
        if start.any() or self.ratio is None or self.ratio.shape != self.y0.shape:
            return start & ~self.dead
        lost = ~torch.isfinite(self.ratio).all(-1)
        return (lost if lost.any() else (self.ratio.abs() > 1).any(-1)) & ~self.dead


def _largest(ratio: Tensor) -> Tensor:
    return ratio.abs().max() if ratio.numel() else ratio.new_zeros(())


def _sentence(method: str, rows: Tensor, t: Tensor, shape: torch.Size) -> str:
    sample = "the sample" if not shape else named(rows)
    who = sample if rows.any() else "a sample that could not be named"
    return (
        f"{method} failed on {who} after t = {t.item():.6g} s: the step shrank to nothing, too "
        f"many steps were taken, or the rates were not finite; {ADVICE}"
    )


@torch.no_grad()
def _check_reconstruction(solve: _Solve, ys: Tensor, t: Tensor) -> None:
    """Integrate back over each output interval, as adjoints do, and compare with what is stored."""
    from torchdiffeq import odeint

    scale = solve.tolerances["atol"] + ys.abs().amax(tuple(range(ys.ndim - 1)))
    worst, options = 0.0, dict(solve.options)
    if solve.adaptive:  # a state that runs away is not followed for ever
        options["max_num_steps"] = max(100, solve.evaluations)
    for i in range(len(t) - 1):
        try:
            back = odeint(
                solve,
                ys[i + 1],
                t[i : i + 2].flip(0),
                method=solve.method,
                options=options,
                **solve.tolerances,
            )
            error = ((back[-1] - ys[i]).abs() / scale).amax(-1)[~solve.dead].max().item()
        except AssertionError:
            error = float("inf")
        worst = max(worst, error) if error == error else float("inf")
    if worst > TRUSTED:
        warn(
            "the continuous adjoint cannot be trusted here: integrated back, the state misses "
            f"itself by {worst:.2g} of its largest value (up to {TRUSTED:g} is accepted); use "
            "adjoint=False, or ask for more outputs",
            UserWarning,
        )
