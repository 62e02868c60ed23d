"""Moving horizon: the state and the unknowns of a structure, by a fit to the last readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.arguments import count, instance
from ...linear.chart import Place
from ...math.shapes import broadcast_shapes
from ...math.square_root import triangle
from ...scene.scene import Scene
from ...state.state import State
from .filtered import Filtered, Predicted
from .kalman_filter import KalmanFilter
from .limits import within
from .weighting import ROUNDS, SETTLED

MOVED = 1.0  # deviation of a parameter, after which all intervals are linear anew


class Begin(NamedTuple):
    """Of an interval: state and x (..., size), inputs (..., inputs) that are given in it, readings
    (..., m) at its end.
    """

    state: State
    x: Tensor
    inputs: Tensor
    y: Tensor


class Linearised(NamedTuple):
    """An interval of a window, linear about its begin as it was estimated.

    begin  of state and x (..., size), under inputs (..., inputs), with readings y (..., m) behind
    place  of that begin;  expected, ends, columns  what follows: `MovingHorizon._moved`
    """

    begin: Begin
    place: Place
    expected: Tensor
    ends: Tensor
    columns: Tensor

    def where(self, which: Tensor, other: Linearised) -> Linearised:
        """This in the samples of a mask (...), the other in the others."""
        if which.all():
            return self

        def chosen(a: Tensor, b: Tensor) -> Tensor:
            return torch.where(which[(...,) + (None,) * (a.ndim - which.ndim)], a, b)

        state = self.begin.state.where(which, other.begin.state)
        begin = Begin(state, *map(chosen, self.begin[1:], other.begin[1:]))
        place = Place(*map(chosen, self.place, other.place))
        return Linearised(begin, place, *map(chosen, self[2:], other[2:]))


class Motion(NamedTuple):
    """The state at an interval's end, and its place; more (..., n): what z is beyond it."""

    state: State
    place: Place
    more: Tensor


@dataclass(frozen=True, eq=False)
class Window:
    """The last W intervals, and what is known of their begin by what was read before.

    mean (..., size), factor (..., size, size)  of x at the first begin
    weight (W, ..., m)  how much each reading counts, by the loss
    places (W, ..., size)  x at the begins, by all readings
    first  state at the first of them, where the interval leaves next;  end  what all say
    """

    mean: Tensor
    factor: Tensor
    intervals: tuple[Linearised, ...]
    weight: Tensor
    places: Tensor
    first: State | None = None
    end: End | None = None


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
    """Moving-horizon estimation from a window of the last readings (Rao, Rawlings and Mayne 2003;
    Diehl, Bock and Schloeder 2005). Gauss-Newton steps update the motion, the unknowns and all
    forces in the window, from the previous estimate. Earlier readings form the arrival cost: an
    extended Kalman filter, with derivatives at the estimate of the whole window. Arguments and
    results are those of `KalmanFilter`. For a linear structure both give the same estimates.

    Args:
        scene, sensors: and `filter`: arguments of `KalmanFilter`, except `second_order`
        window: number of intervals
        iterations: number of Gauss-Newton steps for each reading

    All intervals of a window are simulated side by side (multiple shooting), in about the time of
    one interval of a small batch.

    Raises:
        ValueError: as `KalmanFilter`, and for bounds of an unknown that changes.

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
        **filter: Any,
    ) -> None:
        filter.setdefault("second_order", False)  # intervals are linear about what all say
        super().__init__(scene, sensors, **filter)
        self.window, self.iterations = count("window", window), count("iterations", iterations)
        own, self.limits = self.unknowns, self.limits.of_constants(self.unknowns)
        self.bounded = self.limits.places
        rest = [i for i in range(self.size) if i not in self.bounded.tolist()]
        self.order = torch.cat((self.bounded, self.bounded.new_tensor(rest)))
        # of what comes on top of x in an interval, those that are not zero
        white = torch.ones(int((own.white > 0).sum()), dtype=torch.bool, device=own.white.device)
        self.fresh = torch.cat((own.added > 0, white)).nonzero()[:, 0]

    def predict(self, before: Filtered, u: Any = None) -> Predicted:
        """For `update`; the window is solved there."""
        before = instance("before", before, Filtered).of(self.size)
        return Predicted(before, self.interval.side_by_side(u))

    def update(self, predicted: Predicted, y: Any = None) -> Filtered:
        """What is known an interval later; see `KalmanFilter`."""
        before, inputs, *_ = instance("predicted", predicted, Predicted)
        before.of(self.size)
        x = before.x
        y = self._readings(y, x)
        lead = broadcast_shapes(x.shape[:-1], y.shape[:-1], inputs.shape[:-1])
        x, y, inputs = (part.expand(*lead, -1) for part in (x, y, inputs))
        begin = Begin(before.state.broadcast(lead), x, inputs, y)
        about = self._about(before)
        window, last = self._with(before, begin, about)
        newest = window.intervals[-1]
        sources = self._sources(before.factor, newest.columns)
        known = sources[1][..., : self.read]
        off = y - newest.expected
        error, missed = self.weighting.clipped(known, off, before.missed)
        counts = self.weighting.within_gate(known, error, missed)
        y = y if error is off else y.where(error == off, newest.expected + error)
        gated = begin._replace(y=torch.where(counts, y, torch.nan))
        intervals = (*window.intervals[:-1], newest._replace(begin=gated))
        window = replace(window, intervals=intervals)
        for k in range(self.iterations):
            if k:
                intervals, last = self._linear(self._begins(window), about)
                window = replace(window, intervals=intervals)
            if len(window.intervals) > self.window:
                window = self._without_first(window)
            window = self._solved(window, last)
        counted = window.weight[-1] * counts
        now = self._learned(replace(before, missed=missed), *sources, error, counted)
        return replace(
            now,
            filter=self,
            state=window.end.state,
            x=window.end.x,
            factor=window.end.factor(-1),
            window=window,
            about=about,
        )

    def smooth(self, start: Filtered, found: Sequence[Filtered]) -> list[Filtered]:
        """Estimates of the start, then of each instant of a `run` from it, by the readings up to a
        window later (or to the last). There is one more than in `found`.
        """
        last, known = found[-1].window, [start, *found]
        begins = self._begins(last)
        intervals, motion = self._linear(begins, self._about(found[-1]))
        last = self._solved(replace(last, intervals=intervals), motion)
        begins = self._begins(last)
        lately = min(len(begins), len(found))
        smooth = []
        for j, now in enumerate(known[: -lately - 1]):
            window = known[j + self.window].window
            (first,) = self._begins(window, 1)
            smooth.append(replace(now, state=first.state, x=first.x, factor=window.end.factor(0)))
        for k in range(-lately, 0):
            at = dict(state=begins[k].state, x=begins[k].x, factor=last.end.factor(k - 1))
            smooth.append(replace(known[k - 1], **at))
        return [*smooth, found[-1]]

    def _begins(self, window: Window, first: int | None = None) -> list[Begin]:
        """Of the first intervals of a window, as they are estimated now; None = of all."""
        old = [interval.begin for interval in window.intervals[:first]]
        places = window.places[:first].unbind()
        if window.first is not None and first == 1:
            return [old[0]._replace(state=window.first, x=places[0])]
        near = State.stack([begin.state.broadcast() for begin in old])
        change = torch.stack([x - begin.x for x, begin in zip(places, old, strict=True)])
        states = self.interval.changed(near, change[..., : self.moves])
        return [
            begin._replace(state=states[k], x=x)
            for k, (begin, x) in enumerate(zip(old, places, strict=True))
        ]

    def _linear(
        self, begins: Sequence[Begin], about: Tensor
    ) -> tuple[tuple[Linearised, ...], Motion]:
        """About these begins, side by side; and how the last ends."""
        states, x, inputs, _ = zip(*begins, strict=True)
        after, *parts = self._moved(State.stack(states), together(x), together(inputs), about)
        (starts, ends), more = after.places, after.more[..., : self.moves]
        each = zip(begins, map(Place, *starts), *(part.unbind() for part in parts), strict=True)
        last = Motion(after.state[-1], Place(*(part[-1] for part in ends)), more[-1])
        return tuple(Linearised(*own) for own in each), last

    def _with(self, before: Filtered, begin: Begin, about: Tensor) -> tuple[Window, Motion]:
        """The window with the interval that begins so, and how that ends; intervals that
        stood on what is doubtful now are linear about the estimate: the one that leaves, or all of
        a sample.
        """
        window, x, weight = before.window, begin.x[None], torch.ones_like(begin.y)[None]
        if window is None:
            intervals, last = self._linear([begin], about)
            return Window(begin.x, before.factor, intervals, weight, x), last
        old, places = window.intervals, window.places
        stood = together([interval.begin.x for interval in old])
        far = (places - stood).abs() > MOVED * before.factor.norm(dim=-2)
        far = far[..., self.moves : self.moves + self.unknowns.of_model].any(-1).any(0)
        leaves = int(len(old) == self.window)
        again = len(old) if far.any() else leaves
        begins = self._begins(window, again) if again else []
        new, last = self._linear([*begins, begin], about)
        stay = [k.where(far, o) for k, o in zip(new[leaves:again], old[leaves:again], strict=True)]
        intervals = (*new[:leaves], *stay, *old[again:], new[again])
        places, weight = (
            torch.cat((past.expand(len(past), *part.shape[1:]), part))
            for past, part in ((places, x), (window.weight, weight))
        )
        return replace(window, intervals=intervals, places=places, weight=weight), last

    def _without_first(self, window: Window) -> Window:
        """With what the first interval says in what is known of the second's begin."""
        first = window.intervals[0]
        by_x = first.columns[..., : self.size, :]
        off = ((window.mean - first.begin.x)[..., None, :] @ by_x)[..., 0, :]
        error = first.begin.y - first.expected - off[..., : self.read]
        by_x, sources = self._sources(window.factor, first.columns)
        weight = torch.where(torch.isnan(error), 0.0, window.weight[0])
        learnt = self.weighting.conditioned(by_x, sources, error, weight)[1]
        mean = first.ends + off[..., self.read :] + learnt.change
        factor = learnt.root[..., : self.size, :]
        return Window(mean, factor, window.intervals[1:], window.weight[1:], window.places[1:])

    def _solved(self, window: Window, last: Motion) -> Window:
        """After a Gauss-Newton step: at the least of |v|^2 and the losses of the readings, v (N,)
        independent sources of unit variance: of x at the begin, and of what comes on top in each
        interval. last: how the last ends, as was expected.
        """
        m, size = self.read, self.size
        begins, starts, *parts = zip(*window.intervals, strict=True)
        _, x, _, y = zip(*begins, strict=True)
        x, y = together(x), together(y)
        expected, ends, columns = (together(part) for part in parts)
        by_x, by_fresh = columns.split((size, columns.shape[-2] - size), -2)
        sources = torch.cat((self.shaken @ by_x, by_fresh[..., self.fresh, :]), -2)
        nodes, (W, *lead, s, _) = torch.cat((x[1:], ends[-1:])), sources.shape
        N = size + W * s
        more = x.new_zeros(W, *lead, N + 1, m + size)  # rows: of each source, and of the mean
        more[..., N, m:] = ends - nodes
        of_each = more[..., size:N, :].unflatten(-2, (W, s)).diagonal(dim1=0, dim2=-3)
        of_each.copy_(sources.movedim(0, -1))
        now = x.new_zeros(*lead, N + 1, size)
        now[..., :size, :] = self._ordered(window.factor)
        now[..., N, :] = window.mean - x[0]
        rows = [pad(now, (m, 0))]
        for by, top in zip(by_x, more, strict=True):
            rows.append(rows[-1][..., m:] @ by + top)
        rows = torch.stack(rows)
        roots, off, G = rows[..., :N, m:], rows[..., N, m:], rows[1:, ..., :N, :m]
        seen = ~torch.isnan(y)
        share = seen / self.interval.instruments.noise
        r = torch.nan_to_num(y - expected - rows[1:, ..., N, :m], nan=0.0) * share
        G, weight = G.flip(-2) * share[..., None, :], window.weight
        unit = torch.eye(N, N + 1).to(G).expand(*lead, N, N + 1)
        for _ in range(1 if self.weighting.loss is None else ROUNDS):
            both = torch.cat((G, r[..., None, :]), -2) * weight.sqrt()[..., None, :]
            both = both.movedim(0, -1).flatten(-2)  # (..., N + 1, m W)
            whole = triangle(torch.cat((unit, both.mT), -2))
            R, c = whole[..., :N, :N], whole[..., :N, N:]
            v = torch.linalg.solve_triangular(R, self._bounded(R, c, window), upper=True)
            if self.weighting.loss is None:
                break
            after = self.weighting.loss((r - (G.mT @ v)[..., 0]) * seen)
            moves = ((after - weight).abs() > SETTLED * after).any(-1, keepdim=True).any(0)
            if not moves.any():
                break
            weight = torch.where(moves, after, weight)  # of samples that are settled no more
        places = torch.cat((x[:1], nodes)) + off + (roots.mT @ v.flip(-2))[..., 0]
        change = (places[-1] - ends[-1])[..., : self.moves] + last.more
        near, first = last.state.broadcast(tuple(lead)), None
        if W < self.window:
            state = self.interval.changed(near, change, last.place)
        else:  # in one go, the begin of what leaves next
            near = State.stack([begins[0].state.broadcast(tuple(lead)), near])
            change = torch.stack(((places[0] - x[0])[..., : self.moves], change))
            place = Place(*(together(pair) for pair in zip(starts[0], last.place, strict=True)))
            both = self.interval.changed(near, change, place)
            first, state = both[0], both[1]
        end = End(state, places[-1], roots, R)
        return replace(window, places=places[:-1], weight=weight, first=first, end=end)

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
        inside = within(M.mT @ M, best, *self.limits.ends)
        return torch.cat((c[..., :-p, :], M @ (inside - mean)[..., None]), -2)


def together(parts: Sequence[Tensor]) -> Tensor:
    """(W, ...) of tensors that broadcast."""
    same = len({part.shape for part in parts}) == 1
    return torch.stack(list(parts) if same else torch.broadcast_tensors(*parts))
