"""Moving horizon: the state and the unknowns of a structure, by a fit to the last readings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.arguments import choice, count, instance
from ...core.validation import as_tensor, refusal, shown
from ...math.shapes import broadcast_shapes
from ...math.square_root import triangle
from ...scene.scene import Scene
from ...state.state import State
from ..identification.losses import HUBER, STUDENT
from .filtered import Filtered
from .kalman_filter import KalmanFilter

LOSSES: dict[str, Callable[[Tensor], Tensor]] = {  # weights of squares, by readings' deviations
    "huber": lambda u: HUBER / u.abs().clamp(min=HUBER),
    "student": lambda u: (STUDENT + 1) / (STUDENT + u.square()),
}
ROUNDS = 20  # in which weights, or what stands at a bound, are found
SETTLED = 1e-4  # change of weights that is none


@dataclass(frozen=True, eq=False)
class Window:
    """The last W intervals, and what is known of their begin by what was read before.

    mean (..., size), factor (..., size, size)  of x at the first begin;  known  its factor by all
    starts (W, ...), x (W, ..., size)  of each begin;  inputs (W, ..., inputs) that were given
    y (W, ..., m)  readings at the ends;  weight (W, ..., m) of these, by the loss
    """

    mean: Tensor
    factor: Tensor
    known: Tensor
    starts: State
    x: Tensor
    inputs: Tensor
    y: Tensor
    weight: Tensor

    def then(self, now: Filtered, lead: tuple[int, ...], inputs: Tensor, y: Tensor) -> Window:
        """With one interval more, of samples `lead`."""

        def more(parts: Tensor, last: Tensor) -> Tensor:
            own = parts.shape[-1]
            return torch.cat((parts.expand(-1, *lead, own), last.expand(1, *lead, own)))

        state = now.state.broadcast(lead)[None]
        return replace(
            self,
            starts=self.starts.map(lambda a, b: torch.cat((a, b)), state),
            x=more(self.x, now.x),
            inputs=more(self.inputs, inputs),
            y=more(self.y, y),
            weight=more(self.weight, torch.ones_like(y)),
        )


class Linearised(NamedTuple):
    """The window about its states: what follows from each; `MovingHorizon._moved` of all."""

    states: State
    expected: Tensor
    ends: Tensor
    columns: Tensor


class End(NamedTuple):
    """State and x (..., size) at the window's end; what x at each of its instants follows from,
    (..., rows, size): the first of v; the triangle (..., N, N) of v's information, its last first.
    """

    state: State
    x: Tensor
    roots: list[Tensor]
    R: Tensor

    def factor(self, k: int) -> Tensor:
        """(..., size, size) of x at the k-th instant."""
        root = self.roots[k]
        rows = pad(root, (0, 0, 0, self.R.shape[-1] - root.shape[-2])).flip(-2)
        return triangle(torch.linalg.solve_triangular(self.R.mT, rows, upper=False))


class MovingHorizon(KalmanFilter):
    """Estimates by a window of the last readings: a Gauss-Newton step on the motion, the unknowns
    and all forces in it, about the motion that was estimated before (Rao, Rawlings and Mayne 2003;
    Diehl, Bock and Schloeder 2005). What was read before is its arrival cost: an extended Kalman
    filter, whose derivatives are those about what the whole window says. It takes and gives what
    `KalmanFilter` does; of a linear structure both say the same.

    Args:
        scene, sensors: as `filter`, all that `KalmanFilter` takes
        window: intervals
        iterations: Gauss-Newton steps a reading
        loss: "huber" or "student": of readings that miss by much, in place of squares
        bounds: name of an offset, or of a force of math.inf s -> (least, largest). Those of a
            parameter are its own, `tb.Parameter(bounds=)`. They hold for the estimate; its
            deviation is that without them

    All intervals of a window are simulated side by side (multiple shooting), so that they take
    about as long as one of a small batch.

    Raises ValueError as `KalmanFilter` does, and for bounds of what is not constant.

    Examples:
        >>> f = tb.MovingHorizon(
        ...     tb.Scene(beam, [tb.TipLoad(force=tb.Input("push", 3)), tb.Damping(0.01)]),
        ...     tb.sensors.TipPosition(),
        ...     dt=0.02,
        ...     noise=1e-3,
        ...     process={"push": (0.1, 0.5)},
        ...     window=10,
        ...     loss="student",
        ... )
        >>> z = f(f.start(), (1.0, 0.0, 0.002))
        >>> z.state.tip.position.shape, z.unknown["push[2]"].shape
        (torch.Size([3]), torch.Size([]))
    """

    def __init__(
        self,
        scene: Scene | Callable[[dict[str, Tensor]], Scene],
        sensors: Any,
        *,
        window: int = 20,
        iterations: int = 1,
        loss: str | None = None,
        bounds: Mapping[str, Any] | None = None,
        **filter: Any,
    ) -> None:
        super().__init__(scene, sensors, **filter)
        self.window, self.iterations = count("window", window), count("iterations", iterations)
        self.loss = None if loss is None else LOSSES[choice("loss", loss, tuple(LOSSES))]
        own = self.unknowns
        least, largest = (self.like.new_full((len(own.names),), e) for e in (-torch.inf, torch.inf))
        if own.parameters is not None:
            p, ends = own.of_model, own.parameters.bounds(own.parameters.x[0])
            least[:p], largest[:p] = (end.to(least) for end in ends)
        for name, pair in (bounds or {}).items():
            i = own.names.index(choice("a name of bounds", name, own.names))
            ends = as_tensor(pair, least.dtype, least.device)
            if i < own.of_model or ends.shape != (2,) or not ends[0] < ends[1]:
                wanted = "(least, largest) of an offset or a force, or tb.Parameter(bounds=),"
                raise refusal(f"bounds[{name!r}] = {shown(pair)}", wanted)
            least[i], largest[i] = ends
        held = torch.isfinite(least) | torch.isfinite(largest)
        for i in (held & ((own.added > 0) | (own.stays < 1))).nonzero()[:, 0].tolist():
            raise refusal(f"bounds of {own.names[i]!r}, which changes,", "what is constant")
        self.least, self.largest = least[held], largest[held]
        self.bounded = self.moves + held.nonzero()[:, 0]  # of x
        rest = [i for i in range(self.size) if i not in self.bounded.tolist()]
        self.order = torch.cat((self.bounded, self.bounded.new_tensor(rest)))
        # of what comes on top of x in an interval, those that are not zero
        white = torch.ones(int((own.white > 0).sum()), dtype=torch.bool, device=held.device)
        self.fresh = torch.cat((own.added > 0, white)).nonzero()[:, 0]

    def __call__(self, before: Filtered, y: Any = None, u: Any = None) -> Filtered:
        """What is known an interval later; see `KalmanFilter`."""
        x, inputs = instance("before", before, Filtered).x, self._inputs(u)
        y = self._readings(y, x)
        lead = broadcast_shapes(x.shape[:-1], y.shape[:-1], inputs.shape[:-1])
        window = before.window
        if window is None:
            none = [like.new_zeros(0, *lead, like.shape[-1]) for like in (x, inputs, y, y)]
            start = before.state.broadcast(lead)[None][:0]
            window = Window(x, before.factor, before.factor, start, *none)
        window = window.then(before, lead, inputs, y)
        for k in range(self.iterations):
            about = Linearised(*self._moved(window.starts, window.x, window.inputs))
            if k == 0:
                newest = (about.columns[-1], window.y[-1] - about.expected[-1])
            if len(window.x) > self.window:
                window, about = self._without_first(window, about)
            window, end = self._solved(window, about)
        by_x, learnt = self._conditioned(before.factor, *newest, window.weight[-1])
        read = (~torch.isnan(newest[1])).sum(-1).to(x)
        now = replace(
            before,
            filter=self,
            state=end.state,
            x=end.x,
            factor=end.factor(-1),
            nis=(learnt.unit**2).sum(-1),
            readings=read,
            log_likelihood=before.log_likelihood + learnt.log_density(read),
            learnt=(by_x, learnt),
            window=replace(window, known=end.factor(0)),
        )
        return now.judged()

    def smooth(self, start: Filtered, found: Sequence[Filtered]) -> list[Filtered]:
        """What is known of the start, and of each instant of a `run` from it, by the readings up to
        a window later (or to the last): one more than `found`.
        """
        last, known = found[-1].window, [start, *found]
        about = Linearised(*self._moved(last.starts, last.x, last.inputs))
        window, end = self._solved(last, about)
        lately = min(len(window.x), len(found))
        smooth = []
        for j, now in enumerate(known[: -lately - 1]):
            first = known[j + self.window].window
            at = dict(state=first.starts[0], x=first.x[0], factor=first.known)
            smooth.append(replace(now, **at))
        for k in range(-lately, 0):
            at = dict(state=window.starts[k], x=window.x[k], factor=end.factor(k - 1))
            smooth.append(replace(known[k - 1], **at))
        return [*smooth, found[-1]]

    def _without_first(self, window: Window, about: Linearised) -> tuple[Window, Linearised]:
        """With what the first interval says in what is known of the second's begin."""
        states, expected, ends, columns = about
        by_x = columns[0][..., : self.size, :]
        off = ((window.mean - window.x[0])[..., None, :] @ by_x)[..., 0, :]
        error = window.y[0] - expected[0] - off[..., : self.read]
        learnt = self._conditioned(window.factor, columns[0], error, window.weight[0])[1]
        starts, *rest = (
            part[1:] for part in (window.starts, window.x, window.inputs, window.y, window.weight)
        )
        mean = ends[0] + off[..., self.read :] + learnt.change
        factor = learnt.root[..., : self.size, :]
        later = Linearised(states[1:], *(part[1:] for part in (expected, ends, columns)))
        return Window(mean, factor, factor, starts, *rest), later

    def _solved(self, window: Window, about: Linearised) -> tuple[Window, End]:
        """After a Gauss-Newton step: at the least of |v|^2 and the losses of the readings, v (N,)
        independent sources of unit variance: of x at the begin, and of what comes on top in each
        interval.
        """
        m, size = self.read, self.size
        root = self._ordered(window.factor)
        off = window.mean - window.x[0]
        roots, changes, slopes, errors = [root], [off], [], []
        seen = ~torch.isnan(window.y)
        error = torch.nan_to_num(window.y - about.expected, nan=0.0)
        by_x, by_fresh = about.columns.split((size, about.columns.shape[-2] - size), -2)
        sources = torch.cat((self.shaken @ by_x, by_fresh[..., self.fresh, :]), -2)
        nodes = torch.cat((window.x[1:], about.ends[-1:]))
        for k in range(len(error)):
            both = torch.cat((root @ by_x[k], sources[k]), -2)
            moved = (off[..., None, :] @ by_x[k])[..., 0, :]
            root, off = both[..., m:], about.ends[k] + moved[..., m:] - nodes[k]
            roots.append(root)
            changes.append(off)
            slopes.append(both[..., :m])
            errors.append(error[k] - moved[..., :m])
        N = root.shape[-2]
        G = torch.stack([pad(slope, (0, 0, 0, N - slope.shape[-2])) for slope in slopes])
        share = seen / self.interval.instruments.noise
        G, r = G.flip(-2) * share[..., None, :], torch.stack(errors) * share
        unit, weight = torch.eye(N, N + 1).to(G).expand(*r.shape[1:-1], N, N + 1), window.weight
        for _ in range(1 if self.loss is None else ROUNDS):
            rows = torch.cat((G, r[..., None, :]), -2) * weight.sqrt()[..., None, :]
            rows = rows.movedim(0, -1).flatten(-2)  # (..., N + 1, m W)
            whole = triangle(torch.cat((unit, rows.mT), -2))
            R, c = whole[..., :N, :N], whole[..., :N, N:]
            v = torch.linalg.solve_triangular(R, self._bounded(R, c, window), upper=True)
            if self.loss is None:
                break
            before, weight = weight, self.loss((r - (G.mT @ v)[..., 0]) * seen)
            if (weight - before).abs().max() < SETTLED:
                break
        changes = [
            off + (root.mT @ v.flip(-2)[..., : root.shape[-2], :])[..., 0]
            for off, root in zip(changes, roots, strict=True)
        ]
        places = torch.cat((window.x[:1], nodes)) + torch.stack(changes)
        near = window.starts[:1].map(lambda a, b: torch.cat((a, b)), about.states.broadcast())
        z, n = torch.cat((window.x[:1], about.ends))[..., : self.moves], self.moves
        states = self.interval.changed(near, places[..., :n] - z)
        window = replace(window, starts=states[:-1], x=places[:-1], weight=weight)
        return window, End(states[-1], places[-1], roots, R)

    def _ordered(self, factor: Tensor) -> Tensor:
        """A factor of the same covariance, in which what is bounded follows from its first rows."""
        if not len(self.bounded):
            return factor
        return triangle(factor[..., self.order])[..., self.order.argsort()]

    def _bounded(self, R: Tensor, c: Tensor, window: Window) -> Tensor:
        """c (..., N, 1), such that R v = c has what is bounded within its bounds, and |R v - c| is
        least among these.
        """
        if not (p := len(self.bounded)):
            return c
        own, mean = self.bounded, window.mean[..., self.bounded]
        by_v = self._ordered(window.factor)[..., :p, :][..., own].mT.flip(-1)
        M = torch.linalg.solve(by_v.mT, R[..., -p:, -p:].mT).mT  # R v by what is bounded
        best = mean + torch.linalg.solve(M, c[..., -p:, :])[..., 0]
        inside = within(M.mT @ M, best, self.least, self.largest)
        return torch.cat((c[..., :-p, :], M @ (inside - mean)[..., None]), -2)


def within(H: Tensor, best: Tensor, least: Tensor, largest: Tensor) -> Tensor:
    """x (..., p) within bounds (p,) at which (x - best)^T H (x - best) is least, by the primal-dual
    active set method (Hintermueller, Ito and Kunisch 2003).
    """
    x, held = best, torch.zeros_like(best, dtype=torch.bool)
    size = H.diagonal(dim1=-2, dim2=-1)
    for _ in range(ROUNDS):
        pulled = x - (H @ (x - best)[..., None])[..., 0] / size
        before, held = held, (pulled < least) | (pulled > largest)
        if torch.equal(before, held):
            break
        at = torch.where(held, torch.maximum(torch.minimum(pulled, largest), least) - best, 0.0)
        free = ~held[..., :, None] & ~held[..., None, :]
        A = torch.where(free, H, torch.diag_embed(size))
        b = torch.where(held, size * at, -(H @ at[..., None])[..., 0])
        x = best + torch.linalg.solve(A, b[..., None])[..., 0]
    return torch.maximum(torch.minimum(x, largest), least)
