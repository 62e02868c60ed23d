"""Mechanisms: rigid motions of a beam, or of the parts of a structure, that neither supports and
joints nor loads hold.

A pendulum that hangs is held by its weight, once that has stressed it. So the stress that the loads
bring about is found with the motions held that nothing else holds, and a load step then begins with
the stiffness of that stress. What is still held by nothing, as the turn of a pendulum about itself,
gets a brace, a stiffness of one node in the tangent alone: where no load drives that motion, the
balance, the solution and its derivatives are those without the brace.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import no_derivatives
from ..core.leaves import leaf
from ..core.validation import concrete
from ..equations.steady import Configuration, SteadyProblem
from ..math.shapes import broadcast_shapes
from ..nodal import loads as external
from ..nodal.coordinates.planar import PLANES
from ..nodal.element_loads import element_matrix
from ..nodal.model import Model
from ..scene.scene import Scene
from ..scene.supports import AXES
from ..state.state import rest
from ..topology.protocols import Matrix, total

NONE = 1e-8  # of the largest: a singular value that is none
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
    if clamped(problem.model):
        return x, None
    with no_derivatives():
        free = _free(problem, x)
        adrift = free.any(-1).any(-1)
        if not concrete(adrift).any():
            return x, None
        at_rest = problem.apply_supports(x)
        held = _braced(problem, at_rest, free)
        residual, *about = held.residual(at_rest)
        change = held.linearise(at_rest, *about).solve(residual.nodes, residual.strain)[1]
        x = x._replace(stress=torch.where(adrift[..., None, None], x.stress + change, x.stress))
        nodes, bases, _ = _hold(problem, x)
        moves = _in_space(problem, _moves(nodes, bases))
        force = torch.einsum("...anw,...nw->...a", moves, problem.residual(x)[0].nodes)
        stiffness, _ = _stiffness(problem, x, moves)
        by = torch.linalg.pinv((free @ stiffness @ free).double(), rtol=NONE)
        swing = (by @ (free @ force[..., None]).double())[..., 0].abs().amax(-1)
        return x, adrift & (swing > SWING)


def braced(problem: SteadyProblem, x: Configuration) -> SteadyProblem:
    """The problem with braces for rigid motions that neither supports nor loads, with the stress of
    x, hold; itself where there are none.
    """
    if clamped(problem.model):
        return problem
    with no_derivatives():
        free = _free(problem, x)
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
        nodes, bases, hold = _hold(SteadyProblem(model, t, inputs, t.new_ones(())), start)
    _, s, V = torch.linalg.svd(sample_of(hold, 2, sample), full_matrices=True)
    motions = V[int((s > NONE).sum()) :].to(nodes)
    if model.scene.beam.parts:
        return len(motions), _parts_in_words(motions, bases)
    at = bases[0].node
    return len(motions), _words(motions, sample_of(nodes, 2, sample)[at], at)


def clamped(model: Model) -> bool:
    """Whether all is held without a look at loads, or by a frame that turns."""
    return model.turning or _welded_to_clamps(model.scene)


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


def _free(problem: SteadyProblem, x: Configuration) -> Tensor:
    """(..., m, m) projector onto the rigid motions that nothing holds, see `_hold`; zero where
    there are none.
    """
    nodes, _, hold = _hold(problem, x)
    _, s, V = torch.linalg.svd(hold, full_matrices=True)
    none = (pad(s, (0, max(0, hold.shape[-1] - s.shape[-1]))) <= NONE)[..., None] * V
    return (none.mT @ none).to(nodes)


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
    length, braces = _length(model.scene.beam.nodes.detach())[..., None, None], torch.zeros_like(D)
    for k, base in enumerate(_bases(model)):
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
    return _free(problem, x).diagonal(dim1=-2, dim2=-1).sum(-1).round()


class Base(NamedTuple):
    """A part that moves as a rigid one: its name, its nodes, and the one that its rotations are
    about.
    """

    name: str
    nodes: slice
    node: int


def _bases(model: Model) -> list[Base]:
    """The beam, or all parts of a structure; rotations are about the first node that has a support,
    or the first of all.
    """
    held = sorted(model.constraints.nodes)
    parts = [(part.name, part.nodes) for part in model.scene.beam.parts] or [
        ("", slice(0, model.node_count))
    ]
    return [
        Base(name, nodes, next((n for n in held if nodes.start <= n < nodes.stop), nodes.start))
        for name, nodes in parts
    ]


def sample_of(x: Tensor, own: int, sample: tuple[int, ...]) -> Tensor:
    """One sample of x (..., `own` axes), whose leading axes may be fewer than the batch's, or one
    long.
    """
    lead = x.shape[: x.ndim - own]
    return concrete(x)[
        tuple(
            i if n > 1 else 0 for n, i in zip(lead, sample[len(sample) - len(lead) :], strict=True)
        )
    ]


def _hold(problem: SteadyProblem, x: Configuration) -> tuple[Tensor, list[Base], Tensor]:
    """Nodes (..., N+1, 3) m, the bases, and the matrix (..., m, 6 of each part), of size one, which
    takes rigid motions of x to what holds them: displacement of a base (in lengths of all) and
    rotation to those that supports, joints and the scene's plane forbid, and to the generalised
    forces by which loads and stress resist what is left.
    """
    model, bases = problem.model, _bases(problem.model)
    nodes = (
        model.space.public_position(x.position)
        if model.space.turns
        else model.scene.beam.nodes.detach()
    )
    moves, left, parts = _moves(nodes, bases), torch.eye(6 * len(bases)).to(nodes), []
    held = _forbidden(problem, x, nodes, moves)
    if held is not None:
        _, s, V = torch.linalg.svd(held, full_matrices=True)
        rank = pad(s > NONE * s[..., :1], (0, max(0, held.shape[-1] - s.shape[-1])))
        free = torch.where(rank[..., None], 0.0, V)  # rows
        left = (free.mT @ free).to(nodes)
        parts.append(held / s[..., :1, None])
    parts.append(_resisted(problem, x, moves, left))
    lead = broadcast_shapes(*(x.shape[:-2] for x in parts))
    return nodes, bases, torch.cat([x.expand(*lead, *x.shape[-2:]) for x in parts], -2)


def _moves(nodes: Tensor, bases: list[Base]) -> tuple[Tensor, Tensor]:
    """Displacements m and rotations (..., 6 of each part, N+1, 3) of all nodes by each rigid
    motion.
    """
    eye, parts = torch.eye(6).to(nodes), []
    for base in bases:
        own = nodes[..., base.nodes, :]
        shift, turn = (
            x[:, None].expand(*own.shape[:-2], 6, own.shape[-2], 3) for x in eye.split(3, -1)
        )
        arm = (own - nodes[..., base.node : base.node + 1, :])[..., None, :, :].expand_as(turn)
        shift = _length(nodes)[..., None, None, None] * shift + torch.linalg.cross(turn, arm)
        others = (0, 0, base.nodes.start, nodes.shape[-2] - base.nodes.stop)
        parts.append([pad(x, others) if len(bases) > 1 else x for x in (shift, turn)])
    return tuple(x[0] if len(bases) == 1 else torch.cat(x, -3) for x in zip(*parts, strict=True))


def _length(nodes: Tensor) -> Tensor:
    length = torch.linalg.vector_norm(nodes.diff(dim=-2), dim=-1).sum(-1)
    return torch.where(length > 0, length, 1.0)  # of a body alone


def _forbidden(
    problem: SteadyProblem, x: Configuration, nodes: Tensor, moves: tuple[Tensor, Tensor]
) -> Tensor | None:
    """(..., m, 6 of each part) what supports, joints and the scene's plane forbid, by each rigid
    motion; None = nothing.
    """
    (shift, turn), model = moves, problem.model
    scene, size = model.scene, _length(nodes)[..., None]
    rows = [
        shift[..., s.node, i] / size if i < 3 else turn[..., s.node, i - 3]
        for s in scene.supports
        for i, fixed in enumerate(s.held)
        if fixed
    ]
    if scene.plane is not None:
        normal = int(torch.tensor(PLANES[scene.plane][2]).abs().argmax())
        eye = torch.eye(shift.shape[-3]).to(nodes)
        out = (normal, *(3 + j for j in range(3) if j != normal))
        rows += [row for k, row in enumerate(eye) if k % 6 in out]
    if model.joints.count:
        G = _joined(problem, x).constraints()
        G = G / torch.linalg.vector_norm(G, dim=-1, keepdim=True) / size[..., None]
        rows += (G @ _in_space(problem, moves).flatten(-2).mT).unbind(-2)
    return torch.stack(torch.broadcast_tensors(*rows), -2).double() if rows else None


def _resisted(
    problem: SteadyProblem, x: Configuration, moves: tuple[Tensor, Tensor], left: Tensor
) -> Tensor:
    """(..., 6, 6) generalised forces by which loads, and the stress of x, resist the rigid motions
    that are `left`, a projector; of size one.
    """
    work, size = _stiffness(problem, x, _in_space(problem, moves))
    work = left @ work @ left
    most = work.abs().amax((-1, -2), keepdim=True)
    resisted = most > NONE * size
    return torch.where(resisted, work / torch.where(resisted, most, 1), 0).double()


def _stiffness(problem: SteadyProblem, x: Configuration, moves: Tensor) -> tuple[Tensor, Tensor]:
    """(..., 6, 6) of rigid motions, moves (..., 6, N+1, w) of the nodes, by loads and the stress of
    x; (..., 1, 1) the size of its terms.
    """
    model, space = problem.model, problem.model.space
    own, _ = model.joints.split(x.stress)
    stress = space.geometric_stiffness(model.kinematics(x.position, x.rotation), own, model.length)
    ends, size = model.assembly.to_elements(moves), _largest(stress)
    work = torch.einsum("...anw,...nwv,...bnv->...ab", ends, stress, ends)
    all_moves = moves.flatten(-2)
    for matrix in _between(problem, x):
        blocks = matrix.dense()
        work = work + all_moves @ blocks @ all_moves.mT
        size = torch.maximum(size, blocks.abs().amax((-1, -2), keepdim=True))
    if problem.conditions.moving:
        by = external.tangent(model, problem.nodes(x), problem.conditions)
        if not isinstance(by, float):
            work = work - torch.einsum("...anw,...nwv,...bnv->...ab", moves, by, moves)
            size = torch.maximum(size, _largest(by))
    return work, size * _largest(moves) ** 2


def _between(problem: SteadyProblem, x: Configuration) -> Iterator[Matrix]:
    """What joints, loads between nodes, and tendons each add to the tangent."""
    model = problem.model
    loads = element_matrix(model, problem.nodes(x), problem.conditions)
    if model.joints.count:
        yield _joined(problem, x)
    if loads is not None:
        yield loads.each(torch.neg)
    if model.scene.tendons or model.scene.pairs:
        w = model.space.unknowns
        none = model.topology.diagonal(x.position.new_zeros(model.node_count, w, w))
        tied = model.tendons.matrix(none, lambda: problem.tendon_motion(x))
        yield model.touching.matrix(tied, lambda: problem.touching_motion(x))


def _joined(problem: SteadyProblem, x: Configuration) -> Any:
    """The matrix of the joints alone."""
    joints = problem.model.joints
    return joints.alone(
        joints.blocks_of(problem.joint_poses(x), joints.split(x.stress)[1], None, 1.0)
    )


def _in_space(problem: SteadyProblem, moves: tuple[Tensor, Tensor]) -> Tensor:
    """Displacements and rotations (..., 3) as moves (..., w)."""
    space = problem.model.space
    return torch.cat((space.project_vector(moves[0]), space.project_spin(moves[1])), -1)


def _largest(x: Tensor) -> Tensor:
    """(..., 1, 1) of the numbers (..., n, w, v), or (..., k, n, w)."""
    return (x.abs().amax((-1, -2, -3)) if x.numel() else x.new_zeros(x.shape[:-3]))[..., None, None]


def _parts_in_words(motions: Tensor, bases: list[Base]) -> str:
    """Which parts rigid motions (m, 6 of each part) move."""
    moved = (motions.unflatten(-1, (len(bases), 6)).abs() > NONE**0.5).any(0).any(-1)
    names = _list(
        [repr(base.name) for base, there in zip(bases, moved.tolist(), strict=True) if there]
    )
    if len(motions) == 1:
        return f"one motion of {names}" if names else ""
    return f"{len(motions)} motions of {names}" if names else ""


def _words(motions: Tensor, place: Tensor, at: int) -> str:
    if len(motions) == 0:
        return ""
    whole = motions.mT @ motions  # onto their span
    lone = [i for i in range(6) if whole[i, i] > 1 - 1e-6]
    shown = [
        f"the {what} {_list([AXES[i % 3] for i in lone if i // 3 == k])}{there}"
        for k, (what, there) in enumerate(
            (("displacement along", ""), ("rotation about", f" at node {at}"))
        )
        if any(i // 3 == k for i in lone)
    ]
    rest = motions - motions[:, lone] @ torch.eye(6).to(motions)[lone] if lone else motions
    rest = torch.linalg.svd(rest, full_matrices=False)[2][: len(motions) - len(lone)]
    for shift, turn in (motion.split(3) for motion in rest):
        about = torch.linalg.vector_norm(turn)
        shown.append(
            f"a displacement along {_vector(shift)}"
            if about < 1e-6
            else f"a rotation about {_vector(turn / about)}"
            + (f" at node {at}" if shift.norm() < 1e-6 else "")
        )
    return " and ".join(shown)


def _list(names: list[str]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1]) if len(names) > 1 else names)


def _vector(x: Tensor) -> str:
    return "(" + ", ".join(f"{v:.3g}" for v in (x * x[x.abs().argmax()].sign()).tolist()) + ")"
