"""Moving horizon: the state and the unknowns of a structure, by a fit to the last readings."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
MOVED = 1.0  # deviation of a parameter, after which all intervals are linear anew


class Intervals(NamedTuple):
    """Intervals (W, ...) of a window, each linear about its begin as it was estimated.

    starts (W, ...), x (W, ..., size)  of that begin;  inputs (W, ..., inputs) that were given
    states, expected, ends, columns  what follows: `MovingHorizon._moved`
    y (W, ..., m)  readings at the ends;  weight (W, ..., m) of these, by the loss
    places (W, ..., size)  x at the begin, by all readings
    """

    starts: State
    x: Tensor
    inputs: Tensor
    states: State
    expected: Tensor
    ends: Tensor
    columns: Tensor
    y: Tensor
    weight: Tensor
    places: Tensor

    def part(self, which: slice) -> Intervals:
        return Intervals(*(part[which] for part in self))

    def then(self, later: Intervals) -> Intervals:
        return Intervals(*_joined(self, later))


@dataclass(frozen=True, eq=False)
class Window:
    """The last intervals, and what is known of their begin by what was read before.

    mean (..., size), factor (..., size, size)  of x at the first begin;  known  its factor by all
    """

    mean: Tensor
    factor: Tensor
    known: Tensor
    intervals: Intervals

    @property
    def weight(self) -> Tensor:
        """(W, ..., m): how much each reading counts, by the loss."""
        return self.intervals.weight


class End(NamedTuple):
    """State and x (..., size) at the window's end; what x at each of its instants follows from,
    (W + 1, ..., N, size); the triangle (..., N, N) of v's information, its last first.
    """

    state: State
    x: Tensor
    roots: Tensor
    R: Tensor

    def factor(self, k: int) -> Tensor:
        """(..., size, size) of x at the k-th instant."""
        rows = self.roots[k].flip(-2)
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
        state, x = before.state.broadcast(lead), x.expand(*lead, -1)
        y, inputs = (part.expand(*lead, -1) for part in (y, inputs))
        begin = state[None], x[None], inputs[None], y[None], torch.ones_like(y)[None]
        if (window := before.window) is None:
            window = Window(x, before.factor, before.factor, self._linear(*begin))
            newest = window.intervals
        else:
            window, newest = self._with(window, begin, before.factor)
        for k in range(self.iterations):
            if k:
                window = replace(window, intervals=self._linear(*self._begins(window.intervals)))
            if len(window.intervals.x) > self.window:
                window = self._without_first(window)
            window, end = self._solved(window)
        error = (newest.y - newest.expected)[-1]
        weight = window.weight[-1]
        by_x, learnt = self._conditioned(before.factor, newest.columns[-1], error, weight)
        read = (~torch.isnan(error)).sum(-1).to(x)
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
        last = replace(last, intervals=self._linear(*self._begins(last.intervals)))
        window, end = self._solved(last)
        states, x, *_ = self._begins(window.intervals)
        lately = min(len(x), len(found))
        smooth = []
        for j, now in enumerate(known[: -lately - 1]):
            first = known[j + self.window].window
            begin, place, *_ = self._begins(first.intervals.part(slice(1)))
            smooth.append(replace(now, state=begin[0], x=place[0], factor=first.known))
        for k in range(-lately, 0):
            at = dict(state=states[k], x=x[k], factor=end.factor(k - 1))
            smooth.append(replace(known[k - 1], **at))
        return [*smooth, found[-1]]

    def _begins(self, old: Intervals) -> tuple[State, Tensor, Tensor, Tensor, Tensor]:
        """What `_linear` takes, about the begins as they are estimated now."""
        change = (old.places - old.x)[..., : self.moves]
        starts = self.interval.changed(old.starts, change)
        return starts, old.places, old.inputs, old.y, old.weight

    def _linear(
        self, starts: State, x: Tensor, inputs: Tensor, y: Tensor, weight: Tensor
    ) -> Intervals:
        """About these begins."""
        return Intervals(starts, x, inputs, *self._moved(starts, x, inputs), y, weight, x)

    def _with(
        self, window: Window, begin: Iterable[Any], factor: Tensor
    ) -> tuple[Window, Intervals]:
        """With the interval that begins so; those that stood on what is doubtful now are linear
        about the estimate: the one that leaves, or all; and what is so.
        """
        old, of_model = window.intervals, slice(self.moves, self.moves + self.unknowns.of_model)
        moved = (old.places - old.x).abs() > MOVED * factor.norm(dim=-2)
        again = len(old.x) if moved[..., of_model].any() else int(len(old.x) == self.window)
        if again:
            begin = _joined(self._begins(old.part(slice(again))), begin)
        new = self._linear(*begin)
        stays = old.part(slice(again, None)).then(new.part(slice(again, None)))
        return replace(window, intervals=new.part(slice(again)).then(stays)), new

    def _without_first(self, window: Window) -> Window:
        """With what the first interval says in what is known of the second's begin."""
        first = Intervals(*(part[0] for part in window.intervals))
        by_x = first.columns[..., : self.size, :]
        off = ((window.mean - first.x)[..., None, :] @ by_x)[..., 0, :]
        error = first.y - first.expected - off[..., : self.read]
        learnt = self._conditioned(window.factor, first.columns, error, first.weight)[1]
        mean = first.ends + off[..., self.read :] + learnt.change
        factor = learnt.root[..., : self.size, :]
        return Window(mean, factor, factor, window.intervals.part(slice(1, None)))

    def _solved(self, window: Window) -> tuple[Window, End]:
        """After a Gauss-Newton step: at the least of |v|^2 and the losses of the readings, v (N,)
        independent sources of unit variance: of x at the begin, and of what comes on top in each
        interval.
        """
        m, size, own = self.read, self.size, window.intervals
        by_x, by_fresh = own.columns.split((size, own.columns.shape[-2] - size), -2)
        sources = torch.cat((self.shaken @ by_x, by_fresh[..., self.fresh, :]), -2)
        nodes, (W, *lead, s, _) = torch.cat((own.x[1:], own.ends[-1:])), sources.shape
        N = size + W * s
        more = own.x.new_zeros(W, *lead, N + 1, m + size)  # rows: of each source, and of the mean
        more[..., N, m:] = own.ends - nodes
        of_each = more[..., size:N, :].unflatten(-2, (W, s)).diagonal(dim1=0, dim2=-3)
        of_each.copy_(sources.movedim(0, -1))
        now = own.x.new_zeros(*lead, N + 1, size)
        now[..., :size, :] = self._ordered(window.factor)
        now[..., N, :] = window.mean - own.x[0]
        rows = [pad(now, (m, 0))]
        for k in range(W):
            rows.append(rows[-1][..., m:] @ by_x[k] + more[k])
        rows = torch.stack(rows)
        roots, off, G = rows[..., :N, m:], rows[..., N, m:], rows[1:, ..., :N, :m]
        seen = ~torch.isnan(own.y)
        share = seen / self.interval.instruments.noise
        r = torch.nan_to_num(own.y - own.expected - rows[1:, ..., N, :m], nan=0.0) * share
        G, weight = G.flip(-2) * share[..., None, :], own.weight
        unit = torch.eye(N, N + 1).to(G).expand(*lead, N, N + 1)
        for _ in range(1 if self.loss is None else ROUNDS):
            both = torch.cat((G, r[..., None, :]), -2) * weight.sqrt()[..., None, :]
            both = both.movedim(0, -1).flatten(-2)  # (..., N + 1, m W)
            whole = triangle(torch.cat((unit, both.mT), -2))
            R, c = whole[..., :N, :N], whole[..., :N, N:]
            v = torch.linalg.solve_triangular(R, self._bounded(R, c, window), upper=True)
            if self.loss is None:
                break
            before, weight = weight, self.loss((r - (G.mT @ v)[..., 0]) * seen)
            if (weight - before).abs().max() < SETTLED:
                break
        places = torch.cat((own.x[:1], nodes)) + off + (roots.mT @ v.flip(-2))[..., 0]
        change = (places[-1] - own.ends[-1])[..., : self.moves]
        state = self.interval.changed(own.states[-1].broadcast(tuple(lead)), change)
        intervals = own._replace(places=places[:-1], weight=weight)
        return replace(window, intervals=intervals), End(state, places[-1], roots, R)

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


def _joined(earlier: Iterable[Any], later: Iterable[Any]) -> Iterator[Any]:
    """Both of each pair of tensors or states (W, ...), of the samples of the later one."""

    def both(a: Tensor, b: Tensor) -> Tensor:
        return torch.cat((a.expand(len(a), *b.shape[1:]), b))

    for a, b in zip(earlier, later, strict=True):
        if isinstance(a, State):
            yield a.broadcast((a.batch_shape[0], *b.batch_shape[1:])).map(both, b.broadcast())
        else:
            yield both(a, b)


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
