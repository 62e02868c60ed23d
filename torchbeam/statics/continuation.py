"""Continuation: equilibria one after another along their path, as the load changes.

The load factor is an unknown beside the moves, and one more equation says how far a step goes. With
t the unit tangent of the path, (move, change of factor), and <, > the mean over the nodes of
dr.dr/L^2 + spin.spin, plus the product of the changes of the factor over its range:

    arc length     <t, way> = step                 (the normal plane of Riks 1979)
    control        q(state) = where it is to be    (displacement control, q any quantity)

Stability is read off the pivots of the tangent (Haynsworth 1968).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.status import DIVERGED
from ..core.validation import unmapped
from ..equations.load_steps import WOUND, turn_of_supports
from ..equations.steady import Configuration, Past
from ..math.shapes import broadcast_shapes
from ..nodal.model import Model
from ..solvers.newton import newton
from ..state.state import rest
from .arc_length import ArcLengthProblem, EagerPoint, LoadedProblem, PathPoint, where
from .stability import NEUTRAL, conservative, eigenvalues, sign

REGULAR, LIMIT_POINT, BRANCH_POINT = range(3)
TURN = 1.0  # rad that a node may turn in one step
START = 0.5  # rad that a node may turn in the start of a step
ITERATIONS = 12  # in a step: one that takes more is quicker in two
EASY = 4  # iterations after which the step stays as it is; fewer, and it grows
LEAST = 1e-4  # smallest step, as a share of the first
ALIKE = 0.7  # cosine between the tangents at the ends of a step: 45 degrees
ALONG = 0.92  # between the chord of a step and a tangent at its ends: half of that, as of an arc
STRAIGHT = 0.99  # the same of a step past a branch point, which may have left the path: 8 degrees
ENOUGH = 1e-9  # of the way of a controlled quantity
MODE = 6  # inverse iterations for a critical shape
TRACE = 1e-12  # of any shape, in what they start from


class PathState(NamedTuple):
    """Equilibrium on a path, of each sample its own; leading axes are batch axes.

    place      shape, load factor and way from the equilibrium before
    reaction   (..., K, w) N and N m, load of each support
    negative   (...) int, negative pivots of the tangent;  sign (...) int, of its determinant
    symmetric  (...) bool, whether the tangent is that of an energy
    move       (..., N+1, w) and by_factor (...): tangent of the path, of unit length
    least      (...) N/m, the softest pivot at the start
    sound      (...) bool: whether all pivots are finite
    past       what was remembered where the way there began, None = nothing is
    """

    place: PathPoint
    reaction: Tensor
    negative: Tensor
    sign: Tensor
    symmetric: Tensor
    move: Tensor
    by_factor: Tensor
    least: Tensor
    sound: Tensor
    past: Past | None

    @property
    def factor(self) -> Tensor:
        return self.place.factor[..., 0, 0]


# where the samples then stand, kind of the way there, whether it is accepted
Attempt = tuple[PathState, Tensor, Tensor]


@dataclass(frozen=True)
class Continuation:
    """Arc-length continuation of equilibria, each sample at its own pace.

    model, loaded  the nodal form, and its balance by the load factor
    span       (lowest, highest) load factor
    step       the first and longest step along the path; of `control`, a share of the way to
               `target`
    control    a quantity (...) of the configuration that leads the path to `target` (...);
               None = the arc length
    branch     whether to go on along branches
    tolerance  of the scaled residual; None = Newton's own
    size       (..., 1, w) weights of a mean move
    """

    model: Model
    loaded: LoadedProblem
    span: tuple[float, float]
    step: float
    control: Callable[[Configuration], Tensor] | None
    target: Tensor | None
    branch: bool
    tolerance: float | None
    size: Tensor

    def __call__(
        self, start: Configuration, steps: int, active: Tensor | None = None
    ) -> tuple[list[Attempt], Tensor, Tensor]:
        """The path from an equilibrium at factor 0, in at most so many attempts, of the `active`
        (...) samples, None = all: the attempts, the status (...) of each sample, not 0 of the
        others, and whether (...) it reached the end.
        """
        zero = self.model.length.new_zeros(())
        shape = unmapped("the path of a load", self.loaded(zero).residual(start)[0].measure()).shape
        if self.control is not None:
            shape = broadcast_shapes(shape, self.target.shape)
        start = Configuration(*(v.expand(*shape, *v.shape[-2:]) for v in start))
        none, no = zero.expand(shape), torch.zeros(shape, dtype=torch.bool, device=zero.device)
        zero_move = zero.expand(*start.position.shape[:-1], self.model.space.unknowns)
        place = PathPoint(*start, none[..., None, None], zero_move)
        past = self.loaded.past or Past.of(self.model.scene, rest(self.model.scene))
        past = past and Past(*(x.expand(*shape, *x.shape[-2:]) for x in past))
        now = self.settle(place, none - 1, None, None, past)
        first = None if self.control is None else self.led(start, shape)
        # in which no support turns by more than WOUND
        whole = turn_of_supports(self.loaded(none + self.span[1]), start) * self.span[1]
        longest = (WOUND / whole).clamp(max=self.step) if self.control is None else none + self.step
        still, final, leap, at, step = no.long(), no, no, none, longest
        status = still if active is None else torch.where(active, still, DIVERGED)
        done, record, behind = no, [(now, still, ~no)], now
        for _ in range(steps):
            going = ~done & (status == 0)
            if not going.any():
                break
            width = None if first is None else self.target - first
            goal = None if first is None else first + width * (at + step).clamp(max=1)
            past = self.remembered(now)
            reach = None if first is None else width.abs() * step
            problem, guess = self.problem(now, behind, step, final, leap, goal, reach, past)
            if past is not None:
                guess = where(leap, guess, self.led_on(problem, guess, now))
            outcome = newton(
                problem, guess, going, self.tolerance, ITERATIONS, trust_start=False, foresee=~final
            )
            x, factor = outcome.x, outcome.x.factor[..., 0, 0]
            space = self.model.space
            turn = space.multiply(space.inverse(now.place.rotation), x.rotation)
            calm = space.cosine(turn).abs().amin(-1) > math.cos(TURN / 2)
            good = going & (outcome.status == 0) & calm
            beyond = no
            after = self.settle(x, now.factor, outcome.reaction, now.least, past)
            good = good & after.sound
            kind = torch.where(after.by_factor * now.by_factor < 0, LIMIT_POINT, BRANCH_POINT)
            kind = torch.where(~leap & self.passed(now, after), kind, REGULAR)
            chord = self.along_chord(now, after)
            sharp = (kind == BRANCH_POINT) & (chord < STRAIGHT)
            if first is None:
                beyond = good & ~final & ((factor > self.span[1]) | (factor < self.span[0]))
                sharp = sharp | (~final & ((self.alike(after, now) < ALIKE) | (chord < ALONG)))
            sharp = sharp if past is None else no  # where something yields, a path has a corner
            good = good & ~beyond & ~(sharp & ~leap & (step > LEAST * self.step))
            kind = torch.where(good, kind, REGULAR)
            leaps = good & (kind == BRANCH_POINT) & self.branch
            leaps = leaps & ((after.negative > now.negative) | (after.sign < now.sign))
            now, behind = where(good, (after, now), (now, behind))
            record.append((now, kind, good))
            at = torch.where(good, at + step, at)
            ended = final if first is None else at >= 1 - ENOUGH
            done = done | good & ended & ~leaps
            leap = torch.where(good, leaps, leap)
            quick = torch.where(outcome.iterations <= EASY, 1.5 * step, step).minimum(longest)
            step = torch.where(good, quick, torch.where(beyond, step, step / 2))
            status = torch.where(going & (step < LEAST * self.step), DIVERGED, status)
            final = beyond  # an end that was out of reach in one step is tried again from nearer by
        return record, status, done

    def problem(
        self,
        now: PathState,
        behind: PathState,
        step: Tensor,
        final: Tensor,
        leap: Tensor,
        goal: Tensor | None,
        width: Tensor | None,
        past: Past | None,
    ) -> tuple[ArcLengthProblem, PathPoint]:
        """What the next point has to satisfy, and where Newton's method starts."""
        loaded = replace(self.loaded, past=past)
        start = now.place._replace(way=torch.zeros_like(now.place.way))
        zero = torch.zeros_like(now.factor)
        if goal is not None:
            row = torch.zeros_like(now.move)
            return ArcLengthProblem(loaded, row, zero, now.factor, goal, width, self.control), start
        move, by_factor = now.move, now.by_factor / self.span[1] ** 2
        if leap.any():
            mode = self.mode(now, behind)
            branch_move = step[..., None, None] * mode
            there = loaded(now.factor).update(
                start.shape, branch_move, torch.zeros_like(start.stress)
            )
            start = where(
                leap,
                start._replace(position=there.position, rotation=there.rotation, way=branch_move),
                start,
            )
            move, by_factor = where(leap, (mode, zero), (move, by_factor))
        row, by_factor = where(
            final, (torch.zeros_like(move), zero + 1), (self.size * move, by_factor)
        )
        bound = torch.where(now.by_factor < 0, *now.factor.new_tensor(self.span))
        goal = torch.where(final, bound - now.factor, step)
        return ArcLengthProblem(loaded, row, by_factor, now.factor, goal, goal.abs()), start

    def led_on(self, problem: ArcLengthProblem, start: PathPoint, now: PathState) -> PathPoint:
        """A start further along the tangent, as far as the step goes: what yields at the start goes
        on in the tangent's direction, where Newton's method may take it for elastic else.
        """
        _, _, row, missing = problem.residual(start)
        along = (row * now.move).sum((-1, -2)) + problem.by_factor * now.by_factor
        turn = now.move[..., self.model.space.dims.position :].abs().amax((-1, -2))
        share = missing / torch.where(along == 0, torch.inf, along)
        share = share.clamp(-START / turn, START / turn)
        move = share[..., None, None] * now.move
        change = (share * now.by_factor)[..., None, None]
        return problem.update(start, move, torch.zeros_like(start.stress), change)

    def remembered(self, now: PathState) -> Past | None:
        """At an equilibrium."""
        if now.past is None:
            return None
        problem = replace(self.loaded, past=now.past)(now.factor)
        fields, past = {"stress": now.place.stress}, now.past
        fields = self.model.finished(fields, problem.node_motion(now.place.shape), None, None)
        return Past(fields.get("joints", past.joints), fields.get("memory", past.memory))

    def settle(
        self,
        x: PathPoint,
        before: Tensor,
        reaction: Tensor | None,
        least: Tensor | None,
        past: Past | None,
    ) -> PathState:
        """Stability and tangent at an equilibrium that was come to from the factor `before`, where
        `past` was remembered, its supports where that of `x` has them; the tangent leads on.
        """
        loaded = replace(self.loaded, past=past)
        x = PathPoint(*loaded(x.factor[..., 0, 0]).apply_supports(x.shape), x.factor, x.way)
        point = loaded.balance(x)
        # where one is not, the point is no place to stop at
        blocks, sound = point.pivots(self.model.unit)
        shape = point.residual.measure().shape
        values = eigenvalues(blocks).expand(*shape, *blocks.shape[-3:-1])
        least = values.amin((-1, -2)).clamp(min=0) if least is None else least
        negative = (values < -NEUTRAL * least[..., None, None]).sum((-1, -2))
        move = point.by_factor[0]
        sound = sound & torch.isfinite(move).all(-1).all(-1)
        length = ((self.size * move**2).sum((-1, -2)) + 1 / self.span[1] ** 2).sqrt()
        on = (self.size * move * x.way).sum((-1, -2)) + (x.factor[..., 0, 0] - before) / self.span[
            1
        ] ** 2
        length = torch.where(on < 0, -length, length)
        reaction = point.by_residual[2] if reaction is None else reaction
        return PathState(
            x,
            reaction,
            negative,
            sign(blocks).long().expand(shape),
            conservative(loaded(x.factor[..., 0, 0]), x.shape).expand(shape),
            move / length[..., None, None],
            1 / length,
            least,
            sound.expand(shape),
            past,
        )

    def led(self, start: Configuration, shape: torch.Size) -> Tensor:
        """What `control` reads (...) where the path begins; ValueError where that is not one number
        of each sample.
        """
        value = self.control(start)
        if not isinstance(value, Tensor) or value.shape not in (shape, ()):
            what = f"{tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
            raise ValueError(
                f"a control that returns {what} was given; one number of each sample, "
                f"{tuple(shape)}, is wanted"
            )
        return value.expand(shape)

    def alike(self, a: PathState, b: PathState) -> Tensor:
        """Cosine between two tangents."""
        return (self.size * a.move * b.move).sum((-1, -2)) + a.by_factor * b.by_factor / self.span[
            1
        ] ** 2

    def passed(self, now: PathState, after: PathState) -> Tensor:
        """Whether (...) the tangent has become singular on the way: of symmetric ones their pivots
        tell, of those under loads that are not conservative the determinant alone.
        """
        by_pivots, by_sign = after.negative != now.negative, after.sign != now.sign
        return torch.where(now.symmetric & after.symmetric, by_pivots, by_sign)

    def along_chord(self, now: PathState, after: PathState) -> Tensor:
        """The smaller cosine between a step and the tangents at its two ends: of a path that is
        followed it is that of half the angle between them; a step onto another path, as past a
        branch point that an imperfection has opened, leads across both.
        """
        way, rise = after.place.way, after.factor - now.factor
        chord = now._replace(move=way, by_factor=rise)
        length = ((self.size * way**2).sum((-1, -2)) + (rise / self.span[1]) ** 2).sqrt()
        return torch.minimum(self.alike(chord, now), self.alike(chord, after)) / length

    def mode(self, now: PathState, behind: PathState) -> Tensor:
        """The critical shape, by inverse iteration, of unit length, to the side to which the beam
        went before.
        """
        point = EagerPoint(replace(self.loaded, past=now.past), now.place)
        number = torch.arange(now.move.shape[-2:].numel()).to(now.move)
        # of several shapes, that which the beam leans to
        any_ = torch.cos(1.7 * number + 0.3).unflatten(0, (-1, now.move.shape[-1]))
        v = behind.move + TRACE * any_ / (self.size * len(any_)).sqrt()
        for _ in range(MODE):
            v = point.tangent.solve(-v, torch.zeros_like(point.residual.strain))[0]
            v = v / (self.size * v**2).sum((-1, -2), keepdim=True).sqrt()
        return torch.where((self.size * behind.move * v).sum((-1, -2), keepdim=True) < 0, -v, v)


def move_weights(model: Model) -> Tensor:
    """(..., 1, w) of the squares of a node's displacement and turn in the square of a step."""
    L = model.extent[..., None, None]
    wide, turn = (
        L.expand(*L.shape[:-1], size) for size in (model.space.dims.position, model.space.dims.spin)
    )
    return torch.cat((1 / wide**2, torch.ones_like(turn)), -1) / model.node_count
