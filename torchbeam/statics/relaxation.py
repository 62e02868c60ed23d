"""Relaxation: a beam comes to rest in a fluid so viscous that it has no inertia; where Newton's
method by itself finds nothing.

    mu (r - r_before)/dtau = forces,   mu' theta/dtau = moments
    a node (theta: its turn since, frame a)

by backward Euler, in steps dtau that grow as the beam calms down: with conservative loads each
lowers the energy (the proximal point method; pseudo-transient continuation, Kelley and Keyes 1998).
The loads grow from none to all until tau = 1, or act at once on a shape that is given; then
supports that lead it elsewhere do, until tau = 2: the beam hangs by then, and does not buckle
between them. Once a step turns no node by much, Newton's method
without the fluid takes over.

Impossible stretch and shear are possible at first, and less and less so until all is there: a
straight beam without stretch whose ends come nearer to each other has no shape nearby to begin
with. What is in balance and no minimum, as an arch that would fall out of its plane under loads
within it, is left by a trace of another shape.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from ..core.leaves import leaf
from ..core.status import DIVERGED
from ..core.validation import concrete
from ..equations.load_steps import WOUND, turn_of_supports
from ..equations.steady import Configuration, SteadyProblem
from ..nodal.balance import Residual
from ..nodal.element_loads import Way, body_passed_through, passed_through
from ..nodal.model import Model
from ..solvers.newton import newton
from ..topology.protocols import Matrix, total
from .arc_length import where
from .balance_check import softest
from .mechanism import braced
from .stability import conservative

FIRST, LEAST, STEPS = 1 / 16, 1e-9, 500  # step: the first, and the smallest; how many
# tau in so many steps: what comes no further, as an element that folds by half a turn, stays there
STALLED, PATIENCE = 1e-3, 64
# rad a node may turn in a step, more and it may come to rest elsewhere than the motion does; after
# which Newton's method is tried
TURN, CALM = 0.5, 0.2
EASY, GROWTH = 0.2, (1.1, 4.0)  # rad: after a step with that turn the next is as long again
LIMIT = 12  # iterations
NEAR = 0.05  # rad, and of the beam's extent: shapes with nodes nearer to each other are one
# strain by a force like all loads together, or like EI/L^2: of a softened stretch or shear
SOFT = 1e-2, 1e-3
TRACE = 1e-6  # rad
# of the viscosity over tau = 1: by so little stiffness what is at rest is held, where no motion of
# it, as the roll of a bent round beam about itself, is resisted but by rounding
NEUTRAL = 1e-6


@dataclass(frozen=True)
class Viscous(SteadyProblem):
    """`SteadyProblem` in the fluid: before (`Configuration`), and drag (..., N+1, w) N/m and N
    m/rad of one step; led (...): how much of their motion supports have made.
    """

    before: Configuration = leaf(2)
    drag: Tensor = leaf(2)
    led: Tensor = leaf(0)

    @property
    def support_factor(self) -> Tensor:
        return self.led

    def residual(self, x: Configuration) -> tuple[Residual, Any]:
        residual, *about = super().residual(x)
        space, x = self.model.space, self.apply_supports(x)
        turn = space.theta(space.multiply(space.inverse(self.before.rotation), x.rotation))
        moves = torch.cat((x.position - self.before.position, space.to_frame(x.rotation, turn)), -1)
        return residual._replace(nodes=residual.nodes + self.drag * moves), *about

    def load_tangent(self, x: Configuration) -> Matrix:
        return total(
            self.model.topology.diagonal(torch.diag_embed(self.drag)), super().load_tangent(x)
        )


def relax(
    whole: SteadyProblem,
    x: Configuration,
    tolerance: float | None,
    loaded: bool = False,
    known: Configuration | None = None,
    steps: int = STEPS,
) -> tuple[Configuration, Tensor, Tensor]:
    """From x, each sample at its own pace, to rest in the problem `whole`:
    (shape, reaction, status). Where loads are conservative, every step and the end are minima of
    the energy, not saddles of it. loaded: all loads act on x, and supports are where they lead, or
    where the problem has them begin. known: a shape at rest; what comes near to it ends there,
    without a reaction. steps: at most.
    """
    model, t, inputs = whole.model, whole.t, whole.inputs
    with torch.no_grad():
        probe = whole.residual(x)[0]
        shape = probe.measure().shape
        whole = replace(whole, load_factor=t.new_ones(shape))
        x = Configuration(*(v.expand(*shape, *v.shape[-2:]) for v in x))
        force = force_scale(whole, x)
        viscosity = viscosity_of(model, force)
        flexibility = _flexibility(model, force) if model.law.rigid else force
        led = any(support.displaced for support in model.scene.supports)
        led = led and not (loaded and whole.begun is None)
        end = 2.0 if led else 1.0  # supports move when loads are there
        longest = WOUND / turn_of_supports(whole, x)  # in which a support turns by so much
        reached, step = t.new_full(shape, float(loaded)), t.new_full(shape, FIRST)
        reaction = probe.nodes.new_zeros(*shape, *model.constraints.fixed.shape)
        going = torch.ones(shape, dtype=torch.bool, device=t.device)
        stuck, mark = ~going, reached
        for k in range(1, steps + 1):
            # until supports move, and in what they do next
            room = (end - 1 - reached).clamp(min=0) + longest
            step = torch.where(reached < end, torch.minimum(step, room), step)
            now = (reached + step).clamp(max=end)
            fluid = Viscous(
                model if loaded else _softened(model, (1 - now / end) * flexibility),
                t,
                inputs,
                now.clamp(max=1),
                x,
                viscosity / step[..., None, None],
                led=(now - 1).clamp(min=0) if led else now,
                begun=whole.begun,
                past=whole.past,
            )
            x, good, turned, longer = advance(fluid, x, going & ~stuck, tolerance)
            reached, step = torch.where(good, reached + step, reached), longer * step
            if k % PATIENCE == 0:
                stuck, mark = stuck | (reached - mark < STALLED), reached
            if known is not None:
                back = good & near(model, x, known)
                x, going, good = where(back, known, x), going & ~back, good & ~back
            calm = good & (reached >= end) & (turned < CALM)
            if concrete(calm).any():
                still = braced(whole, x)
                outcome = newton(
                    still, still.apply_supports(x), calm, tolerance, LIMIT, foresee=~calm
                )
                at_rest = calm & (outcome.status == 0) & (_turned(model, x, outcome.x) < CALM)
                at_rest = at_rest & ~_through(still, x, outcome.x)
                factor, drag = whole.load_factor, NEUTRAL * viscosity
                held = replace(fluid, model=model, load_factor=factor, drag=drag, before=outcome.x)
                # what hardly anything resists moves far by the last update, which leaves something
                outcome = newton(held, outcome.x, at_rest, tolerance, LIMIT, foresee=~calm)
                at_rest = at_rest & (outcome.status == 0)
                downhill = conservative(whole, outcome.x)
                if concrete(downhill & at_rest).any():
                    at_rest = at_rest & (~downhill | _minimum(held, outcome.x))
                x = where(at_rest, outcome.x, x)
                reaction = torch.where(at_rest[..., None, None], outcome.reaction, reaction)
                going = going & ~at_rest
            if not concrete(going & ~stuck & (step > LEAST)).any():
                break
        return x, reaction, torch.where(going, DIVERGED, 0)


def advance(
    fluid: Viscous, x: Configuration, going: Tensor, tolerance: float | None
) -> tuple[Configuration, Tensor, Tensor, Tensor]:
    """After one step from x, where it went well: the shape, (...) whether it did, the largest turn
    (rad) of a node in it, and by what factor the next step is longer.
    """
    outcome = newton(fluid, fluid.apply_supports(x), going, tolerance, LIMIT)
    turned = _turned(fluid.model, x, outcome.x)
    good = going & (outcome.status == 0) & (turned < TURN) & ~_through(fluid, x, outcome.x)
    downhill = conservative(fluid, outcome.x)
    if concrete(downhill & good).any():
        saddle = good & downhill & ~_minimum(fluid, outcome.x)
        x, good = where(saddle, _disturbed(fluid, x), x), good & ~saddle
    longer = torch.where(good, (EASY / turned).clamp(*GROWTH), 1 / 4)
    return where(good, outcome.x, x), good, turned, longer


def _through(problem: SteadyProblem, x: Configuration, after: Configuration) -> Tensor:
    """(...) whether straight ways of points lead through an obstacle, as it stands."""
    model, now, still = problem.model, problem.conditions, torch.zeros_like(problem.load_factor)
    way = Way((x.position + after.position) / 2, (after.position - x.position) / 2, still)
    through = body_passed_through(model, way, now)
    through = still > 0 if through is None else through
    return through | passed_through(model, way, now) if now.between else through


def near(model: Model, x: Configuration, known: Configuration) -> Tensor:
    """(...) whether each node is `NEAR` to where it is in a shape."""
    apart = torch.linalg.vector_norm(x.position - known.position, dim=-1).amax(-1)
    return (apart < NEAR * model.extent) & (_turned(model, x, known) < NEAR)


def _minimum(problem: SteadyProblem, x: Configuration) -> Tensor:
    tangent = problem.linearise(x, *problem.residual(x)[1:])
    return tangent.system.positive_definite()


def force_scale(whole: SteadyProblem, x: Configuration) -> Tensor:
    """(...) N, of all loads on x, and what bends the beam."""
    model, load = whole.model, whole.load(x)
    p, length = model.space.dims.position, model.tributary_length.detach().sum((-1, -2))
    bends = softest(model) / length**2 if model.station_count else length.new_zeros(())
    if isinstance(load, float):
        return bends.expand(whole.load_factor.shape)
    force, moment = (v.abs().sum((-1, -2)) for v in (load[..., :p], load[..., p:]))
    return force + moment / length + bends


def viscosity_of(model: Model, force: Tensor) -> Tensor:
    """(..., N+1, w): with which that force would move the beam by its length in tau = 1."""
    p, share = model.space.dims.position, model.tributary_length.detach()
    length = share.sum((-1, -2))
    along = (force / length**2)[..., None, None] * share
    about = along * share**2 / 12
    return torch.cat(
        (
            along.expand(*along.shape[:-1], p),
            about.expand(*about.shape[:-1], model.space.dims.spin),
        ),
        -1,
    )


def _flexibility(model: Model, force: Tensor) -> Tensor:
    """(...) 1/N, at tau = 0, of stretch and shear that are impossible."""
    by_load, by_bending = SOFT
    return 1 / (
        force / by_load + softest(model) / model.length.detach().sum((-1, -2)) ** 2 / by_bending
    )


def _softened(model: Model, flexibility: Tensor) -> Model:
    """The model with that flexibility (...) of stretch and shear that are impossible."""
    if not model.law.rigid:
        return model
    S = model.law.S
    slim = S.shape[-1] == 1
    diagonal = S if slim else S.diagonal(dim1=-2, dim2=-1)[..., None]
    by_force = torch.arange(S.shape[-2], device=S.device)[:, None] < model.space.dims.position
    more = torch.where(by_force & (diagonal == 0), flexibility[..., None, None, None], 0.0)
    return replace(
        model, law=replace(model.law, S=S + (more if slim else torch.diag_embed(more[..., 0])))
    )


def _disturbed(problem: SteadyProblem, x: Configuration) -> Configuration:
    """x with every node turned by about `TRACE`, none like another."""
    space, (nodes, _) = problem.model.space, x.position.shape[-2:]
    angle = torch.cos(
        1.7
        * torch.arange(nodes * space.dims.spin, dtype=x.position.dtype, device=x.position.device)
        + 0.3
    )
    move = torch.nn.functional.pad(
        TRACE * angle.unflatten(0, (nodes, space.dims.spin)), (space.dims.position, 0)
    )
    return problem.update(
        x, move.expand(*x.position.shape[:-1], space.unknowns), torch.zeros_like(x.stress)
    )


def _turned(model: Model, before: Configuration, after: Configuration) -> Tensor:
    """(...) rad, the largest turn of a node."""
    turn = model.space.multiply(model.space.inverse(before.rotation), after.rotation)
    return 2 * torch.arccos(model.space.cosine(turn).abs().amin(-1).clamp(max=1))
