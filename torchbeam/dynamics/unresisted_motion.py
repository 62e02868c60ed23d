"""A motion that neither stiffness nor inertia resists in a step: a null vector of its tangent."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..core.validation import concrete
from ..equations.step_problem import StepProblem

NONE = 1e-13  # of the largest singular value of a tangent whose rows and columns are of one size
ROUNDING = 1e-6  # of a direction
LARGEST = 1500  # unknowns of a tangent that is looked at
DROWNED = 1e10  # how many times what acts in a joint is what acts elsewhere, where that is lost
RESIST = "a section with rotary inertia, or a support or joint that holds it, is wanted"


def unresisted_motion(problem: StepProblem, failed: Tensor) -> str | None:
    """A sentence on it, of the first sample that `failed` (...), where its step begins; None where
    there is none, or the tangent is too large to be looked at. What acts in a joint may be so large
    that rounding leaves nothing of all else: that is said then.
    """
    model = problem.model
    if model.constraints.count > LARGEST:
        return None
    x = problem.apply_supports(problem.predictor())
    matrix = problem.tangent(x, *problem.residual(x)[1:]).matrix
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    K = _first(matrix.dense(), failed)[free][:, free]
    unit = _first(model.unit[..., None, :], failed).repeat(1, model.node_count)[0, free]
    resistance = (K.abs() * unit * unit[:, None]).amax(-1)
    most, row = resistance.max(-1)
    node = int(free[row]) // model.space.unknowns
    driven = {end for joint in model.scene.joints if joint.acts for end in joint.ends}
    drowned = node in driven and bool(most > DROWNED * resistance.median())
    if model.multipliers.count:
        G = _first(matrix.constraints(), failed)[:, free]
        K = torch.cat((torch.cat((K, G.mT), -1), torch.cat((G, G.new_zeros(len(G), len(G))), -1)))
    size = K.abs().amax(-1).sqrt()
    if not bool(torch.isfinite(size).all()) or not bool((size > 0).all()):
        return None
    _, s, V = torch.linalg.svd(K / size / size[:, None])
    if s[-1] > NONE * s[0]:
        return None
    if drowned:
        return (
            f"what acts in a joint of node {_named(model, node)} is more than {DROWNED:.0e} times "
            f"what acts elsewhere, of which {K.dtype} then keeps nothing; a smaller one is wanted"
        )
    moves = K.new_zeros(model.constraints.moving.numel())
    moves[free] = (V[-1] / size)[: len(free)]
    motion = _words(problem, moves.unflatten(0, (model.node_count, -1)))
    return f"neither stiffness nor inertia resists {motion}; {RESIST}"


def _first(x: Tensor, failed: Tensor) -> Tensor:
    """A matrix of the first sample that failed."""
    place = tuple(concrete(failed).nonzero()[0].tolist())
    return concrete(x).expand(*failed.shape, *x.shape[-2:])[place]


def _words(problem: StepProblem, moves: Tensor) -> str:
    """Of moves (N+1, w): that of the node that turns most, or, where none turns, moves most."""
    model, p = problem.model, problem.model.space.dims.position
    space, eye = model.space, torch.eye(3).to(moves)
    shift = moves[:, :p] @ space.project_vector(eye).mT
    turn = moves[:, p:] @ space.project_spin(eye).mT
    turns = bool(turn.abs().max() * model.scene.beam.extent.max() > shift.abs().max() * NONE**0.5)
    vectors = turn if turns else shift
    node = int(torch.linalg.vector_norm(vectors, dim=-1).argmax())
    direction = vectors[node] / torch.linalg.vector_norm(vectors[node])
    direction = torch.where(
        direction.abs() < ROUNDING, 0.0, direction * direction[direction.abs().argmax()].sign()
    )
    motion = "a rotation about" if turns else "a displacement along"
    axis = ", ".join(f"{v:.3g}" for v in direction.tolist())
    return f"{motion} ({axis}) of node {_named(model, node)}"


def _named(model: Any, node: int) -> str:
    """As the user says it."""
    for part in model.scene.beam.parts:
        if part.nodes.start <= node < part.nodes.stop:
            return repr(part.name if part.body else (part.name, node - part.first_node))
    return str(node)
