"""path: equilibria as the load changes, through limit points, snap-through and bifurcations.

The load factor is an unknown beside the moves, and one more equation says how far a step goes. With t the unit tangent
of the path, (move, change of factor), and <, > the mean over the nodes of dr.dr/L^2 + spin.spin, plus the product of the
changes of the factor over its range:

    arc length     <t, way> = step                 (the normal plane of Riks 1979)
    control        q(state) = where it is to be    (displacement control, q any quantity)

Stability is read off the pivots of the tangent (Haynsworth 1968).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.status import DIVERGED
from ..core.validation import as_tensor, boolean, finite, instant, number, shown
from ..core.validation import count as check_count
from ..core.validation import function as check_function
from ..core.validation import tolerance as check_tolerance
from ..math.block_tridiagonal import finite_pivots
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..scene.scene import Scene
from ..solvers.newton import newton
from ..state.state import State, check_state, rest
from .arc_length import ArcLengthProblem, LoadedProblem, PathPoint, load_slope, where
from .steady import Configuration

REGULAR, LIMIT_POINT, BRANCH_POINT = range(3)
TURN = 1.0  # rad that a node may turn in one step
ITERATIONS = 12  # in a step: one that takes more is quicker in two
EASY = 4  # iterations after which the step stays as it is; fewer, and it grows
LEAST = 1e-4  # smallest step, as a share of the first
STEP, STEPS = 0.1, 200  # of the way to a stable branch
ALIKE = 0.7  # cosine between the tangents at the ends of a step: 45 degrees
ENOUGH = 1e-9  # of the way of a controlled quantity
MODE = 6  # inverse iterations for a critical shape
NEUTRAL = 1e-4  # of the softest pivot at the start: a pivot that is less negative does not count
TRACE = 1e-12  # of any shape, in what they start from


@dataclass(frozen=True)
class Path:
    """Equilibria in path order, P of them; leading axes (P, ...). A sample that ended early repeats its last one.

    factor     of the load
    state      `State`, its status that of the whole path
    negative   int: negative pivots of the tangent, 0 = stable (where the loads are conservative); one that is less than 1e-4 of
               the softest at the start does not count: a round column turns about its axis at no cost
    sign       int: of the tangent's determinant, for loads that are not
    kind       int, of the way from the equilibrium before: BRANCH_POINT = 2 where a pivot changed sign without the factor
               turning back, LIMIT_POINT = 1 where it turned back, REGULAR = 0
    valid      bool: False where the last one is repeated
    reached    (...) bool: whether the end asked for was reached
    """

    factor: Tensor
    state: State
    negative: Tensor
    sign: Tensor
    kind: Tensor
    valid: Tensor
    reached: Tensor

    @property
    def stable(self) -> Tensor:
        return self.negative == 0


class _Point(NamedTuple):
    """Where a path has got to. move (..., N+1, 6) and by_factor (...): its tangent, of unit length;
    least (...): the softest pivot at the start; sound (...): whether all pivots are finite.
    """

    place: PathPoint
    reaction: Tensor
    negative: Tensor
    sign: Tensor
    move: Tensor
    by_factor: Tensor
    least: Tensor
    sound: Tensor

    @property
    def factor(self) -> Tensor:
        return self.place.factor[..., 0, 0]


def path(scene: Scene, highest: float = 1.0, *, lowest: float = -math.inf, load: str | None = None, step: float = 0.1,
         steps: int = 200, control: Callable[[State], Tensor] | None = None, target: Any = None, branch: bool = False,
         initial: State | None = None, t: float = 0.0, tolerance: float | None = None, **inputs: Any) -> Path:
    """The equilibria of a scene from no load on, as its load factor changes.

    highest  the path of a sample ends where its factor reaches this, or `lowest`
    load     name of the input that is multiplied by the factor, beside loads that stay; None = all loads are
    step     length of a step along the path: 1 is a node's mean move by L, a mean turn by 1 rad, or the whole `highest`;
             the first and the longest. Halved where Newton's method fails or a node turns by more than 1 rad
    steps    at most this many attempts
    control  q: state -> (...), the path then goes in equal steps of q from where it is to `target` (...), whatever the factor
             does; `step` is a share of that way. It reads positions and rotations
    branch   where a pivot changes sign and the factor does not turn back, go on along the branch that leaves there: by a
             `step` in the critical shape, to the side to which the beam had been going, however little
    initial  an equilibrium at factor 0; None = the undeformed beam
    inputs   by name, (..., size)

    Each sample goes its own way at its own pace. Without derivatives: `equilibrium` has those.

    Raises ValueError for what the nodal form does not take, an unknown `load`, or `control` without `target`.
    """
    walk = _Walk.of(scene, highest, lowest, load, step, control, target, branch, t, tolerance, inputs)
    with no_derivatives():
        start = walk.model.space.start(rest(scene) if initial is None else check_state(initial, scene))
        return walk(Configuration(start.position, start.rotation, start.stress), check_count("steps", steps))


def stable_branch(model: Model, loaded: LoadedProblem, start: Configuration, active: Tensor, tolerance: float | None
                  ) -> tuple[Configuration, Tensor, Tensor]:
    """Shape and reaction at the full load of the `active` samples (...), by way of the branches that bifurcate from the path
    of the others; and which of them got there and are stable.
    """
    walk = _Walk(model, loaded, (-math.inf, 1.0), STEP, None, None, True, tolerance, _weights(model))
    found = walk(start, STEPS, active)
    state = model.space.to_reduced(found.state[-1])
    shape = Configuration(state.position, state.rotation, state.stress)
    return shape, state.reaction, active & found.reached & found.stable[-1]


def _weights(model: Model) -> Tensor:
    """(..., 1, w) of the squares of a node's displacement and turn in the square of a step."""
    L = model.length.detach().sum(-2, keepdim=True)
    wide, turn = (L.expand(*L.shape[:-1], size) for size in (model.space.position, model.space.spin))
    return torch.cat((1 / wide**2, torch.ones_like(turn)), -1) / (model.count + 1)


@dataclass(frozen=True)
class _Walk:
    model: Model
    loaded: LoadedProblem
    span: tuple[float, float]
    step: float
    control: Callable[[Configuration], Tensor] | None
    target: Tensor | None
    branch: bool
    tolerance: float | None
    size: Tensor  # (..., 1, w) weights of a mean move

    @classmethod
    def of(cls, scene, highest, lowest, load, step, control, target, branch, t, tolerance, inputs) -> _Walk:
        model = discretise(scene)
        boolean("branch", branch)
        step = check_tolerance("step", step)
        if control is not None:
            check_function("control", control)
        given = scene.tensors(inputs)
        tolerance = None if tolerance is None else check_tolerance("tolerance", tolerance)
        if load is not None and (not isinstance(load, str) or load not in given):
            raise ValueError(f"load = {shown(load)} was given; the scene's inputs are {', '.join(given) or 'none'}")
        if (control is None) != (target is None):
            raise ValueError("control without target, or target without control, was given; both or neither are wanted")
        if control is not None and branch:
            raise ValueError("branch with control was given; it goes by the length of the path")
        highest, lowest = number("highest", highest), number("lowest", lowest, infinite=True)
        if not highest > 0 or not lowest <= 0:
            raise ValueError(f"factors from {lowest:g} to {highest:g} were given; a range with 0 in it is wanted")
        time = instant("t", t, scene.beam.nodes)

        loaded = LoadedProblem(model, time, given, load)

        def read(x: Configuration) -> Tensor:
            zero = torch.zeros_like(x.stress[..., 0, 0])
            none = zero[..., None, None].expand(*zero.shape, *model.constraints.fixed.shape)
            return control(loaded(zero).state(x, none, zero.long()))

        goal = None if target is None else finite("target", as_tensor(target, scene.dtype, scene.device))
        return cls(model, loaded, (float(lowest), float(highest)), float(step), control and read, goal, branch,
                   tolerance, _weights(model))

    def __call__(self, start: Configuration, steps: int, active: Tensor | None = None) -> Path:
        zero = self.model.length.new_zeros(())
        shape = self.loaded(zero).residual(start)[0].measure().shape
        if self.control is not None:
            shape = torch.broadcast_shapes(shape, self.control(start).shape, self.target.shape)
        start = Configuration(*(v.expand(*shape, *v.shape[-2:]) for v in start))
        none, no = zero.expand(shape), torch.zeros(shape, dtype=torch.bool, device=zero.device)
        way = zero.expand(*start.position.shape[:-1], self.model.space.unknowns)
        now = self.settle(PathPoint(*start, none[..., None, None], way), none - 1, None, None)
        first = None if self.control is None else self.control(start)
        status, final, leap, at, step = no.long(), no, no, none, none + self.step
        done = no if active is None else ~active
        record, behind = [(now, status, ~no)], now
        for _ in range(steps):
            going = ~done & (status == 0)
            if not going.any():
                break
            width = None if first is None else self.target - first
            goal = None if first is None else first + width * (at + step).clamp(max=1)
            problem, guess = self.problem(now, behind, step, final, leap, goal, None if first is None else width.abs() * step)
            outcome = newton(problem, guess, going, self.tolerance, ITERATIONS)
            x, factor = outcome.x, outcome.x.factor[..., 0, 0]
            space = self.model.space
            turn = space.multiply(space.inverse(now.place.rotation), x.rotation)
            calm = space.cosine(turn).abs().amin(-1) > math.cos(TURN / 2)
            good = going & (outcome.status == 0) & calm
            beyond, sharp = no, no
            after = self.settle(x, now.factor, outcome.reaction, now.least)
            good = good & after.sound
            if first is None:
                beyond = good & ~final & ((factor > self.span[1]) | (factor < self.span[0]))
                sharp = ~final & ~leap & (self.alike(after, now) < ALIKE) & (step > LEAST * self.step)
                good = good & ~beyond & ~sharp
            kind = torch.where(after.by_factor * now.by_factor < 0, LIMIT_POINT, BRANCH_POINT)
            kind = torch.where(good & ~leap & (after.negative != now.negative), kind, REGULAR)
            leaps = good & (after.negative > now.negative) & (kind == BRANCH_POINT) & self.branch
            now, behind = where(good, (after, now), (now, behind))
            record.append((now, kind, good))
            at = torch.where(good, at + step, at)
            ended = final if first is None else at >= 1 - ENOUGH
            done = done | good & ended & ~leaps
            leap = torch.where(good, leaps, leap)
            quick = torch.where(outcome.iterations <= EASY, 1.5 * step, step).clamp(max=self.step)
            step = torch.where(good, quick, torch.where(beyond, step, step / 2))
            status = torch.where(going & (step < LEAST * self.step), DIVERGED, status)
            final = beyond  # an end that was out of reach in one step is tried again from nearer by
        return self.collect(record, status, done)

    def problem(self, now: _Point, behind: _Point, step: Tensor, final: Tensor, leap: Tensor, goal: Tensor | None,
                width: Tensor | None) -> tuple[ArcLengthProblem, PathPoint]:
        """What the next point has to satisfy, and where Newton's method starts."""
        start = now.place._replace(way=torch.zeros_like(now.place.way))
        zero = torch.zeros_like(now.factor)
        if goal is not None:
            row = torch.zeros_like(now.move)
            return ArcLengthProblem(self.loaded, row, zero, now.factor, goal, width, self.control), start
        move, by_factor = now.move, now.by_factor / self.span[1] ** 2
        if leap.any():
            mode = self.mode(now, behind)
            way = step[..., None, None] * mode
            there = self.loaded(now.factor).update(start.shape, way, torch.zeros_like(start.stress))
            start = where(leap, start._replace(position=there.position, rotation=there.rotation, way=way), start)
            move, by_factor = where(leap, (mode, zero), (move, by_factor))
        row, by_factor = where(final, (torch.zeros_like(move), zero + 1), (self.size * move, by_factor))
        bound = torch.where(now.by_factor < 0, self.span[0], self.span[1]).to(now.factor)  # of two numbers: the default dtype
        goal = torch.where(final, bound - now.factor, step)
        return ArcLengthProblem(self.loaded, row, by_factor, now.factor, goal, goal.abs()), start

    def settle(self, x: PathPoint, before: Tensor, reaction: Tensor | None, least: Tensor | None) -> _Point:
        """Stability and tangent at an equilibrium that was come to from the factor `before`; the tangent leads on."""
        still = self.loaded(x.factor[..., 0, 0])
        residual, *about = still.residual(x.shape)
        tangent = still.linearise(x.shape, *about)
        blocks, sound = finite_pivots(tangent.D, tangent.L, tangent.U)  # where one is not, the point is no place to stop at
        shape = residual.measure().shape
        eigenvalues = torch.linalg.eigvalsh((blocks + blocks.mT) / 2).expand(*shape, *blocks.shape[-3:-1])
        least = eigenvalues.amin((-1, -2)).clamp(min=0) if least is None else least
        negative = (eigenvalues < -NEUTRAL * least[..., None, None]).sum((-1, -2))
        sign = torch.linalg.slogdet(blocks).sign.prod(-1).long().expand(shape)
        move, _, root = tangent.solve(load_slope(self.loaded, x), torch.zeros_like(residual.strain))
        sound = sound & torch.isfinite(move).all(-1).all(-1)
        length = ((self.size * move**2).sum((-1, -2)) + 1 / self.span[1] ** 2).sqrt()
        on = (self.size * move * x.way).sum((-1, -2)) + (x.factor[..., 0, 0] - before) / self.span[1] ** 2
        length = torch.where(on < 0, -length, length)
        reaction = root if reaction is None else reaction
        return _Point(x, reaction, negative, sign, move / length[..., None, None], 1 / length, least, sound.expand(shape))

    def alike(self, a: _Point, b: _Point) -> Tensor:
        """Cosine between two tangents."""
        return (self.size * a.move * b.move).sum((-1, -2)) + a.by_factor * b.by_factor / self.span[1] ** 2

    def mode(self, now: _Point, behind: _Point) -> Tensor:
        """The critical shape, by inverse iteration, of unit length, to the side to which the beam went before."""
        still = self.loaded(now.factor)
        residual, *about = still.residual(now.place.shape)
        tangent = still.linearise(now.place.shape, *about)
        any_ = torch.cos(1.7 * torch.arange(now.move.shape[-2:].numel(), device=now.move.device) + 0.3)
        # of several shapes, that which the beam leans to
        v = behind.move + TRACE * any_.to(now.move).unflatten(0, (-1, now.move.shape[-1]))
        for _ in range(MODE):
            v = tangent.solve(-v, torch.zeros_like(residual.strain))[0]
            v = v / (self.size * v**2).sum((-1, -2), keepdim=True).sqrt()
        return torch.where((self.size * behind.move * v).sum((-1, -2), keepdim=True) < 0, -v, v)

    def collect(self, record: list[tuple[_Point, Tensor, Tensor]], status: Tensor, done: Tensor) -> Path:
        """The points that were accepted, in order; the last one again where a sample has fewer."""
        good = torch.stack([g for *_, g in record])
        number = good.sum(0)
        order = torch.argsort((~good).to(torch.int8), dim=0, stable=True)[:int(number.max())]
        k = torch.arange(len(order), device=order.device)[(...,) + (None,) * number.ndim]
        valid = k < number
        order = order.gather(0, torch.minimum(k, number - 1).expand_as(order))

        def of(values: list[Tensor]) -> Tensor:
            stacked = torch.stack(values)
            index = order[(...,) + (None,) * (stacked.ndim - order.ndim)]
            return stacked.gather(0, index.expand(-1, *stacked.shape[1:]))

        points = [point for point, *_ in record]
        shape = Configuration(*(of([getattr(p.place, name) for p in points]) for name in Configuration._fields))
        factor = of([p.factor for p in points])
        state = self.loaded(factor).state(shape, of([p.reaction for p in points]), status.expand(valid.shape))
        kind = torch.where(valid, of([k for _, k, _ in record]), REGULAR)
        return Path(factor, state, of([p.negative for p in points]), of([p.sign for p in points]), kind, valid, done)
