"""Mechanisms: rigid motions of a beam, or of the parts of a structure, that neither supports and
joints nor loads hold.

A pendulum that hangs is held by its weight, once that has stressed it. So the stress that the loads
bring about is found with the motions held that nothing else holds, and a load step then begins with
the stiffness of that stress. What is still held by nothing, as the turn of a pendulum about itself,
gets a brace, a stiffness of one node in the tangent alone: where no load drives that motion, the
balance, the solution and its derivatives are those without the brace.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.leaves import leaf
from ..core.validation import concrete
from ..equations.steady import Configuration, SteadyProblem
from ..math.shapes import broadcast_shapes
from ..nodal.model import Model
from ..nodal.rigid_moves import bases_of, length_of, moves_of
from ..scene.effects import RootSpring
from ..scene.scene import Scene
from ..state.state import rest
from ..topology.protocols import Matrix, total
from .motion_words import motions_in_words, parts_in_words
from .rigid_motions import NONE, as_unknowns, free_motions, holding, sample_of, stiffness_of

STIFF = 1e6  # of a brace, beside the stiffness of its node
# rad, or lengths of the beam: how far it may be to where the loads hold a beam that swings
SWING = 0.5


@dataclass(frozen=True)
class BracedProblem(SteadyProblem):
    """`SteadyProblem` with braces (..., N+1, w, w) in its tangent: stiffnesses of nodes."""

    braces: Tensor = leaf(3, kw_only=True)

    def load_tangent(self, x: Configuration) -> Matrix:
        return total(self.model.topology.diagonal(self.braces), super().load_tangent(x))


def stressed(problem: SteadyProblem, x: Configuration) -> tuple[Configuration, Tensor | None]:
    """x with the stress that loads bring about there, of samples with rigid motions that nothing
    holds as x stands; and (...) bool, which of them the loads drive further than `SWING`, by the
    stiffness of that stress. None = there are no such motions.
    """
    if _clamped_alone(problem.model):
        return x, None
    with no_derivatives():
        free = free_motions(problem, x)
        adrift = free.any(-1).any(-1)
        if not concrete(adrift).any():
            return x, None
        at_rest = problem.apply_supports(x)
        held = _braced(problem, at_rest, free)
        residual, *about = held.residual(at_rest)
        change = held.linearise(at_rest, *about).solve(residual.nodes, residual.strain)[1]
        x = x._replace(stress=torch.where(adrift[..., None, None], x.stress + change, x.stress))
        nodes, bases, _ = holding(problem, x)
        moves = as_unknowns(problem, moves_of(nodes, bases))
        force = torch.einsum("...anw,...nw->...a", moves, problem.residual(x)[0].nodes)
        stiffness, size = stiffness_of(problem, x, moves)
        size = size[..., 0, 0].double()  # beside it, what rounding alone resists is held by nothing
        own = (free @ stiffness @ free).double()
        by = torch.linalg.pinv(own, atol=NONE * size, rtol=torch.full_like(size, NONE))
        swing = (by @ (free @ force[..., None]).double())[..., 0].abs().amax(-1)
        return x, adrift & (swing > SWING)


def braced(problem: SteadyProblem, x: Configuration) -> SteadyProblem:
    """The problem with braces for rigid motions that neither supports nor loads, with the stress of
    x, hold; itself where there are none.
    """
    if clamped(problem.model):
        return problem
    with no_derivatives():
        free = free_motions(problem, x)
        return (
            _braced(problem, problem.apply_supports(x), free) if concrete(free).any() else problem
        )


def unheld(
    model: Model, t: Tensor, inputs: dict[str, Tensor], sample: tuple[int, ...] = ()
) -> tuple[int, str]:
    """How many rigid motions of one sample nothing holds, as it stands undeformed, and what they
    are in words; (0, "") where there are none, or where frame a turns, which holds much by itself.
    """
    if clamped(model):
        return 0, ""
    with no_derivatives():
        start = model.space.start(rest(model.scene))
        start = Configuration(start.position, start.rotation, torch.zeros_like(start.stress))
        nodes, bases, hold = holding(SteadyProblem(model, t, inputs, t.new_ones(())), start)
    _, s, V = torch.linalg.svd(sample_of(hold, 2, sample), full_matrices=True)
    motions = V[int((s > NONE).sum()) :].to(nodes)
    nodes = sample_of(nodes, 2, sample)
    if model.scene.beam.parts:
        return len(motions), parts_in_words(motions, nodes, bases)
    return len(motions), motions_in_words(motions, nodes, bases[0].node)


def clamped(model: Model) -> bool:
    """Whether all is held without a look at loads, or by a frame that turns."""
    return model.turning or _clamped_alone(model)


def _clamped_alone(model: Model) -> bool:
    """The same without a look at a frame that turns: that holds by the stress that it makes."""
    return _welded_to_clamps(model.scene) or _held_elastically(model)


def _held_elastically(model: Model) -> bool:
    """Whether an elastic clamp, the only load of a beam that depends on how it stands, resists all
    of its rigid motions in all samples.
    """
    scene, moving = model.scene, model.loads[0]
    if scene.beam.parts or scene.tendons or len(moving) != 1:
        return False
    (spring,) = moving
    if not isinstance(spring, RootSpring):
        return False
    k, size = spring.stiffness.detach(), scene.beam.length.detach().sum(-1, keepdim=True)
    lead = broadcast_shapes(k.shape[:-1], size.shape[:-1])
    work = torch.cat([x.expand(*lead, 3) for x in (k[..., :3] * size.square(), k[..., 3:])], -1)
    least, most = work.aminmax(dim=-1)
    return bool(concrete(least > NONE * most).all())


def _welded_to_clamps(scene: Scene) -> bool:
    """Whether all parts are clamped, or welded to such, one after the other."""
    structure, clamps = scene.beam, {s.node for s in scene.supports if all(s.held)}
    if not structure.parts:
        return bool(clamps)
    ends = [joint.ends for joint in scene.joints if joint.holds == 6]
    ends += [(None, node) for node in clamps]
    ends = [[None if node is None else structure.part_at(node).name for node in x] for x in ends]
    held, before = {None}, set()
    while held != before:
        before = held
        held = held.union(*(pair for pair in ends if held.intersection(pair)))
    return len(held) > len(structure.parts)


def _braced(problem: SteadyProblem, x: Configuration, free: Tensor) -> BracedProblem:
    """With a brace of a base, against the rigid motions `free`, a projector, that move it, and so
    on with the others that they leave.
    """
    model, space = problem.model, problem.model.space
    eye = torch.eye(3).to(x.position)
    D = problem.tangent(x, *problem.residual(x)[1:]).matrix.diagonal
    stiffness = D.diagonal(dim1=-2, dim2=-1).abs()
    usual = stiffness.amax(-2)
    usual = torch.where(usual > 0, usual, 1.0)
    to_moves = torch.block_diag(space.project_vector(eye).mT, space.project_spin(eye).mT)
    length, braces = (
        length_of(model.scene.beam.nodes.detach())[..., None, None],
        torch.zeros_like(D),
    )
    for k, base in enumerate(bases_of(model)):
        own = free[..., 6 * k : 6 * k + 6, :]
        own_stiffness = stiffness[..., base.node, :]  # of a body none
        root = torch.where(own_stiffness > 0, own_stiffness, usual).sqrt()[..., None]
        moves = root * (to_moves @ torch.cat((length * own[..., :3, :], own[..., 3:, :]), -2))
        U, s, V = torch.linalg.svd(moves, full_matrices=False)
        there = s > NONE * torch.maximum(s[..., :1], root.amax(-2))
        U, V = torch.where(there[..., None, :], U, 0.0), torch.where(there[..., :, None], V, 0.0)
        brace = STIFF * root * (U @ U.mT) * root.mT
        braces = braces.expand(*brace.shape[:-2], *braces.shape[-3:]).clone()
        braces[..., base.node, :, :] = brace
        free = free - V.mT @ V
    return with_braces(problem, braces)


def with_braces(problem: SteadyProblem, braces: Tensor | None) -> SteadyProblem:
    """The problem with these braces, None = none."""
    if braces is None:
        return problem
    return BracedProblem(
        **{field.name: getattr(problem, field.name) for field in fields(SteadyProblem)},
        braces=braces,
    )


def held_by_loads_alone(
    whole: SteadyProblem, none: SteadyProblem, x: Configuration
) -> Tensor | None:
    """(...) bool: whether rigid motions that `none`, of the loads that are there at once, does not
    hold as x stands, are held by the `whole` load: the tangent then has no inverse before it
    acts. None = there are no rigid motions that supports leave.
    """
    if clamped(whole.model):
        return None
    with no_derivatives():
        before = _left(none, x)
        return before > _left(whole, x) if concrete(before).any() else before > 0


def _left(problem: SteadyProblem, x: Configuration) -> Tensor:
    """(...) how many rigid motions of x nothing holds, nor its loads once they have stressed it."""
    x, driven = stressed(problem, x)
    if driven is None:
        return x.stress.new_zeros(())
    return free_motions(problem, x).diagonal(dim1=-2, dim2=-1).sum(-1).round()
