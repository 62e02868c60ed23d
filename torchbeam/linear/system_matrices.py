"""Mass, damping and tangent stiffness about an equilibrium, of the degrees of freedom that supports leave free.

With T = [I, A] the centre's move by a node's displacement and spin, J and H = J omega in frame a, and omega of frame a:

    M = T^T M T + J      D = T^T 2 M ~omega T + J ~omega + ~omega J - ~H
    K = T^T M ~omega ~omega T + ~omega (J ~omega - ~H) + ...

beside damping, elasticity, stress and loads: gyroscopic, and softened by the rotation.

Internal states z of loads are coordinates without inertia behind the moves: with z' = G z + H q + H_v q' + H_a q'' and L z on
the nodes,

    [M, 0; -H_a, 0] [q; z]'' + [D, 0; -H_v, I] [q; z]' + [K, -L; -H, -G] [q; z] = 0
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..math.shapes import broadcast_shapes
from ..math.subspace import Chained
from ..nodal import loads as external
from ..nodal.constitutive_law import times
from ..nodal.discretise import discretise
from ..nodal.loads import Lags
from ..nodal.mass import Blocks, add
from ..nodal.model import Model
from ..state.state import State, check_state
from ..statics.balance_check import check_rest
from ..statics.steady import Configuration, SteadyProblem


def at_rest(model: Model, state: State, t: Tensor, inputs: dict[str, Tensor], lumped: bool) -> State:
    """`state`, to linearise about; ValueError where it is not one of the scene, moves beside frame a or is no equilibrium: with
    the mass that `equilibrium` has, also where the model's is lumped.
    """
    model = discretise(model.scene) if lumped and model.scene.frame is not None else model
    space = model.space
    reduced = space.start(check_state(state, model.scene))
    problem = SteadyProblem(model, t, inputs, torch.ones_like(t))
    if model.internal_states:
        x = Configuration(reduced.position, reduced.rotation, reduced.stress)
        problem = problem.holding(x, reduced.internal)
    check_rest(problem, reduced)
    return state


def matrices(model: Model, state: State, t: Tensor, inputs: dict[str, Tensor]) -> tuple[Tensor, Tensor | None, Tensor]:
    """M, D (None without damping or rotation) and K (..., n, n) at an equilibrium, of the free moves, see `moves`, and the
    internal states of loads.
    """
    M, D, K, lagging = chains(model, state, t, inputs)
    return augmented(model, *(dense(model, *blocks) if blocks else None for blocks in (M, D, K)), lagging)


def augmented(model: Model, M: Tensor, D: Tensor | None, K: Tensor, lagging: Lags | None
              ) -> tuple[Tensor, Tensor | None, Tensor]:
    """The same from the matrices of the free moves alone."""
    M, K = torch.broadcast_tensors(M, K)
    if lagging is None:
        return (M, None, K) if D is None else torch.broadcast_tensors(M, D, K)
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    L, (H, H_v, H_a) = lagging.L.index_select(-2, free), (x.index_select(-1, free) for x in lagging[2:])
    D = torch.zeros_like(K) if D is None else D
    shape = broadcast_shapes(*(x.shape[:-2] for x in (M, D, L)))

    def whole(*parts: Tensor) -> Tensor:
        a, b, c, d = (x.expand(*shape, *x.shape[-2:]) for x in parts)
        return torch.cat((torch.cat((a, b), -1), torch.cat((c, d), -1)), -2)

    none, eye = torch.zeros_like(L), torch.eye(L.shape[-1], dtype=L.dtype, device=L.device)
    return (whole(M, none, -H_a, torch.zeros_like(lagging.G)), whole(D, none, -H_v, eye), whole(K, -L, -H, -lagging.G))


def chains(model: Model, state: State, t: Tensor, inputs: dict[str, Tensor]
           ) -> tuple[Blocks, Blocks, Blocks, Lags | None]:
    """The same as chains of all nodes, see `mass` (D empty without damping or rotation), and what loads with
    internal states add.
    """
    space = model.space
    state = space.to_reduced(state)
    x = Configuration(state.position, state.rotation, state.stress)
    problem = SteadyProblem(model, t, inputs, torch.ones_like(t))
    if model.internal_states:
        problem = problem.holding(x, state.internal)
    kin = model.kinematics(x.position, x.rotation)
    B = space.strain_operator(kin, model.length)
    hB = (model.length[..., None] * B).mT
    K = space.to_blocks(space.geometric_stiffness(kin, x.stress, model.length) + hB @ times(model.law.C, B))
    D = space.to_blocks(hB @ model.law.damping_by(B)) if model.law.damped else ()
    M = model.inertia.matrix(x.rotation, model.inertia.offset.turned(x.rotation))
    K, D = add(K, problem.motion.tangent(*x[:2])), add(D, problem.motion.gyroscopic(*x[:2]))
    moving, lagging = model.loads[0], None
    if moving or model.internal_states:
        nodes, frame = problem.nodes(x), problem.frame
        still = frame.steady_jacobian()
        eyes = (torch.eye(n, dtype=B.dtype, device=B.device)[None] for n in (space.position, space.spin))
        moved = frame.moving_jacobian(*eyes)
        if model.adds_mass:
            M = add(M, (external.added_mass(model, nodes, t, inputs),))
        at = external.tangent(model, nodes, t, inputs, moving, still)
        K = add(K, (-at,))
        lagging = external.lags(model, nodes, t, inputs, still, moved)
        if model.read.intersection(moved):
            D = add(D, (at - external.tangent(model, nodes, t, inputs, moving, moved),))
    return M, D, K, lagging


def chained(model: Model, blocks: Blocks, own: float) -> Chained:
    """Chain of the nodes that elements end at, each with those before it that its element has between (order 2; one in front of
    the first that is not there): with `own` on the diagonal of what is not there or held, and nothing beside it.
    """
    order, w, count = model.scene.beam.order, model.space.unknowns, model.scene.beam.element_count + 1
    shape = broadcast_shapes(*(x.shape[:-3] for x in blocks))
    like, at = blocks[0], torch.arange(model.count + 1, device=blocks[0].device)
    free = model.constraints.moving.to(like.dtype)
    parts = [like.new_zeros(*shape, n, order, order, w, w) for n in (count, count - 1, count - 1)]
    rows, columns = model.space.chain.coupled(at, 0)
    for block, row, column in zip(blocks, (at, *rows), (at, *columns), strict=False):
        held = block.expand(*shape, len(row), w, w) * free[row][..., None] * free[column][..., None, :]
        i, j = row + order - 1, column + order - 1
        for part, first, there in zip(parts, (i, i, j), (i // order == j // order, i // order + 1 == j // order,
                                                         i // order == j // order + 1), strict=True):
            part[..., (first // order)[there], (i % order)[there], (j % order)[there], :, :] = held[..., there, :, :]
    diagonal, upper, lower = (x.transpose(-3, -2).flatten(-4, -3).flatten(-2) for x in parts)
    missing = 1 - unknowns(model).to(like.dtype).unflatten(0, (count, order * w))
    return Chained(diagonal + own * torch.diag_embed(missing), upper, lower)


def unknowns(model: Model) -> Tensor:
    """(n) bool: which of the unknowns of a chain, see `chained`, are free moves."""
    return torch.nn.functional.pad(model.constraints.moving, (0, 0, model.scene.beam.order - 1, 0)).flatten()


def moves(model: Model, free: Tensor) -> Tensor:
    """Free moves (..., n), what stands behind them left out -> displacement and spin of all nodes (..., N+1, 6), frame a, zero
    where constrained.
    """
    at, free = model.constraints.moving.flatten(), free[..., :model.constraints.count]
    whole = free.new_zeros(*free.shape[:-1], at.numel())
    whole = whole.index_copy(-1, at.nonzero()[:, 0], free).unflatten(-1, (model.count + 1, -1))
    if model.space.unknowns == 6:
        return whole
    to = model.space.embed(torch.eye(model.space.unknowns, dtype=model.length.dtype, device=free.device)).to(free.dtype)
    return whole @ to


def dense(model: Model, *blocks: Tensor) -> Tensor:
    """(..., n, n) of the free moves, from blocks of all nodes, one at least."""
    nodes, w = model.count + 1, model.space.unknowns
    shape = broadcast_shapes(*(x.shape[:-3] for x in blocks))
    A = blocks[0].new_zeros(*shape, nodes, nodes, w, w)
    at = torch.arange(nodes, device=A.device)
    rows, columns = model.space.chain.coupled(at, 0)
    for block, row, column in zip(blocks, (at, *rows), (at, *columns), strict=False):
        A[..., row, column, :, :] = block.expand(*shape, len(row), w, w)
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    return A.transpose(-3, -2).flatten(-4, -3).flatten(-2).index_select(-1, free).index_select(-2, free)
