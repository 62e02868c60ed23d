"""Rigid motions of a beam, or of the parts of a structure, and what holds them: supports, joints,
the scene's plane, loads, and the stress that these have brought about.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.validation import concrete
from ..equations.steady import Configuration, SteadyProblem
from ..math.block_tridiagonal import in_unit
from ..math.shapes import broadcast_shapes
from ..nodal import loads as external
from ..nodal.coordinates.planar import PLANES
from ..nodal.element_loads import element_matrix
from ..nodal.rigid_moves import Base, bases_of, length_of, moves_of
from ..topology.protocols import Matrix

NONE = 1e-8  # of the largest: a singular value that is none


def sample_of(x: Tensor, own: int, sample: tuple[int, ...]) -> Tensor:
    """One sample of x (..., `own` axes), whose leading axes may be fewer than the batch's, or one
    long; of axes that `sample` does not name the first.
    """
    lead = x.shape[: x.ndim - own]
    sample = (0,) * (len(lead) - len(sample)) + sample
    return concrete(x)[
        tuple(
            i if n > 1 else 0 for n, i in zip(lead, sample[len(sample) - len(lead) :], strict=True)
        )
    ]


def free_motions(problem: SteadyProblem, x: Configuration) -> Tensor:
    """(..., m, m) projector onto the rigid motions that nothing holds, see `holding`; zero where
    there are none.
    """
    nodes, _, hold = holding(problem, x)
    _, s, V = torch.linalg.svd(hold, full_matrices=True)
    none = (pad(s, (0, max(0, hold.shape[-1] - s.shape[-1]))) <= NONE)[..., None] * V
    return (none.mT @ none).to(nodes)


def holding(problem: SteadyProblem, x: Configuration) -> tuple[Tensor, list[Base], Tensor]:
    """Nodes (..., N+1, 3) m, the bases, and the matrix (..., m, 6 of each part), of size one, which
    takes rigid motions of x to what holds them: displacement of a base (in lengths of all) and
    rotation to those that supports, joints and the scene's plane forbid, and to the generalised
    forces by which loads and stress resist what is left.
    """
    model, bases = problem.model, bases_of(problem.model)
    nodes = (
        model.space.public_position(x.position)
        if model.space.turns
        else model.scene.beam.nodes.detach()
    )
    moves, left, parts = moves_of(nodes, bases), torch.eye(6 * len(bases)).to(nodes), []
    held = _forbidden(problem, x, nodes, moves)
    if held is not None:
        _, s, V = torch.linalg.svd(held, full_matrices=True)
        most = torch.where(s[..., :1] > NONE, s[..., :1], 1.0)  # joints within may forbid none
        rank = pad(s > NONE * most, (0, max(0, held.shape[-1] - s.shape[-1])))
        free = torch.where(rank[..., None], 0.0, V)  # rows
        left = (free.mT @ free).to(nodes)
        parts.append(held / most[..., None])
    parts.append(_resisted(problem, x, moves, left))
    lead = broadcast_shapes(*(x.shape[:-2] for x in parts))
    return nodes, bases, torch.cat([x.expand(*lead, *x.shape[-2:]) for x in parts], -2)


def _forbidden(
    problem: SteadyProblem, x: Configuration, nodes: Tensor, moves: tuple[Tensor, Tensor]
) -> Tensor | None:
    """(..., m, 6 of each part) what supports, joints and the scene's plane forbid, by each rigid
    motion; None = nothing.
    """
    (shift, turn), model = moves, problem.model
    scene, size = model.scene, length_of(nodes)[..., None]
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
    if model.multipliers.count:
        w, motion = model.space.unknowns, problem.node_motion(x)
        whole = model.topology.diagonal(x.position.new_zeros(model.node_count, w, w))
        for interaction in model.interactions:
            if interaction.multipliers.count:  # of the others nothing is read
                whole = interaction.matrix(whole, x.stress, motion)
        G = whole.constraints()
        own = (size * model.unit).repeat(*(1,) * (size.ndim - 1), model.node_count)[..., None, :]
        G = G / torch.linalg.vector_norm(G * own, dim=-1, keepdim=True)
        rows += (G @ as_unknowns(problem, moves).flatten(-2).mT).unbind(-2)
    return torch.stack(torch.broadcast_tensors(*rows), -2).double() if rows else None


def _resisted(
    problem: SteadyProblem, x: Configuration, moves: tuple[Tensor, Tensor], left: Tensor
) -> Tensor:
    """(..., 6, 6) generalised forces by which loads, and the stress of x, resist the rigid motions
    that are `left`, a projector; of size one.
    """
    work, size = stiffness_of(problem, x, as_unknowns(problem, moves))
    work = left @ work @ left
    most = work.abs().amax((-1, -2), keepdim=True)
    resisted = most > NONE * size
    return torch.where(resisted, work / torch.where(resisted, most, 1), 0).double()


def stiffness_of(problem: SteadyProblem, x: Configuration, moves: Tensor) -> tuple[Tensor, Tensor]:
    """(..., 6, 6) of rigid motions, moves (..., 6, N+1, w) of the nodes, by loads and the stress of
    x; (..., 1, 1) the size of its terms.
    """
    model, space = problem.model, problem.model.space
    own, _ = model.multipliers.split(x.stress)
    stress = space.geometric_stiffness(model.kinematics(x.position, x.rotation), own, model.length)
    by_node = model.unit  # all moves in m, all stiffnesses in N/m
    position, spins = by_node.split((space.dims.position, space.dims.spin), -1)
    by_end = torch.cat((position, *[spins] * (space.order + 1)), -1)
    ends, size = model.assembly.to_elements(moves), _largest(in_unit(stress, by_end))
    work = torch.einsum("...anw,...nwv,...bnv->...ab", ends, stress, ends)
    all_moves = moves.flatten(-2)
    for matrix in _between(problem, x):
        blocks = matrix.dense()
        work = work + all_moves @ blocks @ all_moves.mT
        own = by_node.repeat(*(1,) * (by_node.ndim - 1), blocks.shape[-1] // by_node.shape[-1])
        size = torch.maximum(size, _largest(in_unit(blocks[..., None, :, :], own)))
    if problem.conditions.moving:
        by = external.tangent(model, problem.nodes(x), problem.conditions)
        if not isinstance(by, float):
            work = work - torch.einsum("...anw,...nwv,...bnv->...ab", moves, by, moves)
            size = torch.maximum(size, _largest(in_unit(by, by_node)))
    return work, size * _largest(moves / by_node[..., None, None, :]) ** 2


def _between(problem: SteadyProblem, x: Configuration) -> Iterator[Matrix]:
    """What loads between nodes, and all else that is, each add to the tangent."""
    model = problem.model
    loads = element_matrix(model, problem.nodes(x), problem.conditions)
    if loads is not None:
        yield loads.each(torch.neg)
    if model.interactions:
        motion, w = problem.node_motion(x), model.space.unknowns
        none = model.topology.diagonal(x.position.new_zeros(model.node_count, w, w))
        for interaction in model.interactions:
            yield interaction.matrix(none, x.stress, motion)


def as_unknowns(problem: SteadyProblem, moves: tuple[Tensor, Tensor]) -> Tensor:
    """Displacements and rotations (..., 3) as moves (..., w)."""
    space = problem.model.space
    return torch.cat((space.project_vector(moves[0]), space.project_spin(moves[1])), -1)


def _largest(x: Tensor) -> Tensor:
    """(..., 1, 1) of the numbers (..., n, w, v), or (..., k, n, w)."""
    return (x.abs().amax((-1, -2, -3)) if x.numel() else x.new_zeros(x.shape[:-3]))[..., None, None]
