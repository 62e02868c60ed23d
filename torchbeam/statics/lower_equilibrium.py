"""Lower equilibrium: whether a shape at rest, pushed and let go, comes to rest below.

A current of the viscous fluid of `relaxation` pushes it along each axis of space, in both senses,
evenly by length; then the fluid stands still. Loads are conservative here, so that the energies of
two shapes differ by strain energy less the work of loads on any way between them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.validation import concrete
from ..equations.steady import Configuration, SteadyProblem
from ..math.element_shapes import gauss_points
from .arc_length import where
from .relaxation import FIRST, Viscous, advance, force_scale, near, relax, viscosity_of

# of the current: speed, in lengths of the beam over tau = 1, which it lasts; at most so many steps,
# and the shortest: what it breaks, as a beam that is wrung, is not pushed on
SPEED, STEPS, SHORTEST = 1.0, 60, 1e-3
# of force times length: an energy that is less below is not told from what is kept of digits
BELOW = 1e-4
TOLERANCE = 1e-6  # of the scaled residual on the way
POINTS, SURE = (6, 12), 0.05  # of two quadratures, which agree by so much of what is below


class LowerEquilibrium(NamedTuple):
    """below (...) J, by how much another equilibrium is lower, 0.0 = none was met; push (..., 3) N,
    in all, that leads to it.
    """

    below: Tensor
    push: Tensor

    def sentence(self) -> str:
        """Of the first sample that has one, in words."""
        first = tuple(concrete(self.below > 0).nonzero()[0].tolist())
        below, push = (concrete(v)[first].tolist() for v in self)
        force = ", ".join(f"{x:.3g}" for x in push)
        return (
            f"pushed by a force of ({force}) N along its length and let go, it comes to rest "
            f"{below:.3g} J lower (relax it under such a load, then from there without: initial=)"
        )


def lower_equilibrium(whole: SteadyProblem, x: Configuration, good: Tensor) -> LowerEquilibrium:
    """Of the samples `good` (...), at rest at x in the problem `whole`, whose loads are
    conservative: the lowest of those that pushes lead to.
    """
    model, p = whole.model, whole.model.space.dims.position
    with torch.no_grad():
        axes = torch.eye(p, dtype=x.position.dtype, device=x.position.device)
        directions = torch.cat((axes, -axes))
        shape = 2 * p, *good.shape
        rest = Configuration(*(v.expand(*shape, *v.shape[-2:]) for v in x))
        whole = replace(whole, load_factor=whole.t.new_ones(shape), begun=None)
        force = force_scale(whole, rest)
        current = (
            SPEED * model.extent[..., None, None] * directions.view(2 * p, *(1,) * good.ndim, 1, p)
        )
        pushed = _pushed(whole, rest, viscosity_of(model, force), current, good.expand(shape))
        after, _, status = relax(whole, pushed, TOLERANCE, loaded=True, known=rest, steps=2 * STEPS)
        other = good & (status == 0) & ~near(model, after, rest)
        below = torch.where(other, _below(whole, rest, after), 0.0)
        below = torch.where(below > BELOW * force * model.extent, below, 0.0)
        below, which = below.max(0)
        push = model.space.public_vector(SPEED * force[0][..., None] * directions[which])
        return LowerEquilibrium(below, push)


def _pushed(
    whole: SteadyProblem, x: Configuration, viscosity: Tensor, current: Tensor, good: Tensor
) -> Configuration:
    """What the current (..., 1, p), lengths over tau, makes of x until tau = 1; x itself where it
    makes nothing of it.
    """
    rest, reached = x, torch.zeros_like(whole.load_factor)
    step = torch.full_like(reached, FIRST)
    for _ in range(STEPS):
        going = good & (step > SHORTEST) & (reached < 1)
        if not concrete(going).any():
            break
        step = torch.minimum(step, 1 - reached)
        carried = x._replace(position=x.position + step[..., None, None] * current)
        fluid = Viscous(
            whole.model,
            whole.t,
            whole.inputs,
            whole.load_factor,
            carried,
            viscosity / step.clamp(min=SHORTEST)[..., None, None],
            led=whole.load_factor,
        )
        x, moves, _, longer = advance(fluid, x, going, TOLERANCE)
        reached, step = torch.where(moves, reached + step, reached), longer * step
    return where(reached >= 1, x, rest)


def _below(whole: SteadyProblem, a: Configuration, b: Configuration) -> Tensor:
    """(...) J, by how much the energy of b is below that of a; 0.0 where quadratures differ."""
    model = whole.model
    about = [(at.position, at.rotation, whole.eigenstrain) for at in (a, b)]
    strain = [model.strain_energy(*at, model.crept_at_rest(*at)) for at in about]
    rough, fine = (_work(whole, a, b, points) + strain[0] - strain[1] for points in POINTS)
    return torch.where((fine - rough).abs() <= SURE * fine, fine, 0.0)


def _work(whole: SteadyProblem, a: Configuration, b: Configuration, points: int) -> Tensor:
    """(...) J, of all loads on the way from a to b on which each node moves straight and turns
    about one axis.
    """
    space = whole.model.space
    way = b.position - a.position
    turn = space.logarithm(space.multiply(space.inverse(a.rotation), b.rotation))
    total = torch.zeros_like(whole.load_factor)
    for place, weight in zip(*gauss_points(points), strict=True):
        share = float(1 + place) / 2
        rotation = space.multiply(a.rotation, space.exponential(share * turn))
        at = Configuration(a.position + share * way, rotation, torch.zeros_like(a.stress))
        force = -whole.residual(at)[0].nodes  # nothing by the elements, without stress
        moves = torch.cat((way, space.to_frame(rotation, turn)), -1)
        total = total + float(weight) / 2 * (force * moves).sum((-1, -2))
    return total
