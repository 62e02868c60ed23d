"""Mass, damping and tangent stiffness about an equilibrium, of the degrees of freedom that supports
leave free.

With T = [I, A] the centre's move by a node's displacement and spin, J and H = J omega in frame a,
and omega of frame a:

    M = T^T M T + J      D = T^T 2 M ~omega T + J ~omega + ~omega J - ~H
    K = T^T M ~omega ~omega T + ~omega (J ~omega - ~H) + ...

beside damping, elasticity, stress and loads: gyroscopic, and softened by the rotation.

Internal states z of loads are coordinates without inertia behind the moves: with z' = G z + H
q + H_v q' + H_a q'' and L z on the nodes,

    [M, 0; -H_a, 0] [q; z]'' + [D, 0; -H_v, I] [q; z]' + [K, -L; -H, -G] [q; z] = 0
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..core.leaves import wants_gradient
from ..equations.steady import Configuration, Past, SteadyProblem
from ..math.block_matrices import of_blocks
from ..math.block_tridiagonal import BlockChain
from ..math.quadratic_eigen import DENSE
from ..math.shapes import broadcast_shapes
from ..nodal import loads as external
from ..nodal.constitutive_law import times
from ..nodal.discretise import discretise
from ..nodal.element_loads import element_matrix
from ..nodal.loads import Lags
from ..nodal.model import Model
from ..scene.effects.contact_terms import ContactTerms
from ..state.state import State
from ..state.state_check import check_state
from ..statics.balance_check import check_rest
from ..topology.protocols import Matrix, total
from .relaxing import with_arms


def at_rest(
    model: Model, state: State, t: Tensor, inputs: dict[str, Tensor], lumped: bool
) -> State:
    """`state`, to linearise about; ValueError where it is not one of the scene, moves beside frame
    a or is no equilibrium: with the mass that `equilibrium` has, also where the model's is lumped.
    """
    model = discretise(model.scene) if lumped and model.scene.frame is not None else model
    space = model.space
    reduced = space.start(check_state(state, model.scene, "state"))
    past = Past.of(model.scene, reduced)
    problem = SteadyProblem(model, t, inputs, torch.ones_like(t), past=past)
    if model.internal_states:
        x = Configuration(reduced.position, reduced.rotation, reduced.stress)
        problem = problem.holding(x, reduced.internal)
    check_rest(problem, reduced)
    return state


def in_basis(
    model: Model,
    M: Matrix,
    D: Matrix | None,
    K: Matrix,
    lagging: Lags | None = None,
    near: Tensor | None = None,
) -> tuple[tuple[Tensor, Tensor | None, Tensor], Tensor | None]:
    """M, D (None without damping or rotation) and K (..., n, n) of the free moves, see `moves`, and
    the internal states of loads, from those of all nodes, see `of_nodes`; with the basis of the
    moves, see `free_moves`.
    """
    basis = free_moves(model, K, near)
    matrices = (None if matrix is None else dense(model, matrix, basis) for matrix in (M, D, K))
    return augmented(model, *matrices, lagging, basis), basis


def of_chain(
    model: Model, M: Matrix, K: Matrix, count: int
) -> tuple[BlockChain, BlockChain] | None:
    """M and K of the free moves as block tridiagonal matrices, where they are those of a chain
    that is long beside `count` eigenvalues; a vector's free moves are `unknowns.grouped`.
    """
    if model.constraints.count <= max(DENSE, 4 * count):
        return None
    unknowns = model.constraints.unknowns
    mass, stiffness = M.grouped(unknowns, 0.0), K.grouped(unknowns, 1.0)
    return None if mass is None or stiffness is None else (mass, stiffness)


def augmented(
    model: Model, M: Tensor, D: Tensor | None, K: Tensor, lagging: Lags | None, basis: Tensor | None
) -> tuple[Tensor, Tensor | None, Tensor]:
    """The same from the matrices of the free moves alone, in their `basis`, see `free_moves`."""
    M, K = torch.broadcast_tensors(M, K)
    if lagging is None:
        return (M, None, K) if D is None else torch.broadcast_tensors(M, D, K)
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    L = lagging.L.index_select(-2, free)
    H, H_v, H_a = (x.index_select(-1, free) for x in lagging[2:])
    if basis is not None:
        L, H, H_v, H_a = basis.mT @ L, H @ basis, H_v @ basis, H_a @ basis
    return with_states(M, D, K, Lags(L, lagging.G, H, H_v, H_a))


def with_states(
    M: Tensor, D: Tensor | None, K: Tensor, lagging: Lags
) -> tuple[Tensor, Tensor, Tensor]:
    """M, D, K (..., n + Z, n + Z) of moves, and behind them the internal states of loads."""
    L, G, H, H_v, H_a = lagging
    D = torch.zeros_like(K) if D is None else D
    shape = broadcast_shapes(*(x.shape[:-2] for x in (M, D, K, L)))

    def whole(*parts: Tensor) -> Tensor:
        return of_blocks(*(x.expand(*shape, *x.shape[-2:]) for x in parts))

    none, eye = torch.zeros_like(L), torch.eye(L.shape[-1], dtype=L.dtype, device=L.device)
    return (
        whole(M, none, -H_a, torch.zeros_like(G)),
        whole(D, none, -H_v, eye),
        whole(K, -L, -H, -G),
    )


def of_nodes(
    model: Model,
    state: State,
    t: Tensor,
    inputs: dict[str, Tensor],
    solved: SteadyProblem | None = None,
) -> tuple[Matrix, Matrix | None, Matrix, Lags | None]:
    """The same of all nodes (D None: no damping, rotation), and what internal states add; solved:
    the problem whose solution the state is, None = that of the scene.
    """
    space = model.space
    state = space.to_reduced(state)
    x = Configuration(state.position, state.rotation, state.stress)
    past = Past.of(model.scene, state)
    problem = solved
    if solved is None:
        problem = SteadyProblem(model, t, inputs, torch.ones_like(t), past=past)
    if model.internal_states:
        problem = problem.holding(x, state.internal)
    kinematics = model.kinematics(x.position, x.rotation)
    stress, _ = model.multipliers.split(x.stress)
    B = space.strain_operator(kinematics, model.length)
    force_operator = (model.length[..., None] * B).mT
    K = model.assembly.to_matrix(
        space.geometric_stiffness(kinematics, stress, model.length)
        + force_operator @ times(model.law.C, B)
    )
    D = (
        model.assembly.to_matrix(force_operator @ model.law.damping_by(B))
        if model.law.damped
        else None
    )
    M = model.inertia.matrix(x.rotation, model.inertia.offset.turned(x.rotation))
    K, D = total(K, problem.motion.tangent(*x[:2])), total(D, problem.motion.gyroscopic(*x[:2]))
    now, lagging = problem.conditions, None
    if now.moving or now.between or model.internal_states:
        nodes, frame = problem.nodes(x), problem.frame
        still = frame.steady_jacobian()
        eyes = (
            torch.eye(n, dtype=B.dtype, device=B.device)[None]
            for n in (space.dims.position, space.dims.spin)
        )
        moved = frame.moving_jacobian(*eyes)
        if model.adds_mass:
            M = M.plus(external.added_mass(model, nodes, now))
        at = external.tangent(model, nodes, now, still)
        K = K if isinstance(at, float) else K.minus(at)
        lagging = external.lags(model, nodes, now, still, moved)
        if now.between:
            here = element_matrix(model, nodes, now, still)
            K = total(K, here.each(torch.neg))
            if any(_resists(act.load) for act in now.between):
                D = total(D, element_matrix(model, nodes, now, moved).each(torch.neg), here)
        by_rates = any(act.reads.intersection(moved) and _resists(act.load) for act in now.moving)
        rate = at - external.tangent(model, nodes, now, moved) if by_rates else 0.0
        if not isinstance(rate, float):
            D = model.topology.diagonal(rate) if D is None else D.plus(rate)
    lagging = with_arms(model, B, lagging)
    if model.interactions:
        motion = problem.node_motion(x)
        for interaction in model.interactions:
            K = interaction.matrix(K, x.stress, motion)
            M = interaction.mass(M, motion)
            damping = interaction.damping(lambda D=D: _zeros(model, x) if D is None else D, motion)
            D = D if damping is None else damping
    return M, D, K, lagging


def _zeros(model: Model, x: Configuration) -> Matrix:
    w = model.space.unknowns
    return model.topology.diagonal(x.position.new_zeros(model.node_count, w, w))


def _resists(load: Any) -> bool:
    """Whether it may depend on rates at an instant: lossless contact does so in a step alone."""
    return load.lossy if isinstance(load, ContactTerms) else True


def moves(model: Model, free: Tensor, basis: Tensor | None = None) -> Tensor:
    """Free moves (..., n), in their `basis` (..., moves that supports leave free, n), of the same
    leading axes, what stands behind them left out -> displacement and spin of all nodes
    (..., N+1, 6), frame a, zero where constrained.
    """
    at = model.constraints.moving.flatten()
    if basis is not None:
        free = (basis.to(free.dtype) @ free[..., : basis.shape[-1], None])[..., 0]
    free = free[..., : model.constraints.count]
    whole = free.new_zeros(*free.shape[:-1], at.numel())
    whole = whole.index_copy(-1, at.nonzero()[:, 0], free).unflatten(-1, (model.node_count, -1))
    return model.space.embed(whole)


def dense(model: Model, matrix: Matrix, basis: Tensor | None = None) -> Tensor:
    """(..., n, n) of the free moves, in their `basis`, from a matrix of all nodes."""
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    free_part = matrix.dense().index_select(-1, free).index_select(-2, free)
    return free_part if basis is None else basis.mT @ free_part @ basis


def rigid_constraints(K: Matrix) -> Tensor:
    """(..., m, w nodes): the rates of constraints by the nodes' moves.

    Raises:
        ValueError: where one yields to its own force.
    """
    if K.yields:
        raise ValueError(
            "an Interaction whose residual depends on its own unknowns was given to modes or a "
            "linear model; one that gives its wrench without unknowns is wanted there"
        )
    return K.constraints()


def free_moves(model: Model, K: Matrix, near: Tensor | None = None) -> Tensor | None:
    """Basis (..., moves that supports leave free, n) of those that joints leave free as well; None
    where there are no joints. K: the tangent stiffness with these. near: the basis of a state
    nearby, which it is to follow; None = one that is orthonormal by `Model.unit`.

    With N a basis at the values, Z = N - G^T (G G^T)^-1 G N has these, and the derivatives of G
    Z = 0.
    """
    if not model.multipliers.count:
        return None
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    G = rigid_constraints(K).index_select(-1, free)
    N = near
    if near is None:  # in moves and turns that move the far end alike, whatever the units
        size = model.unit[..., None, :].expand(*model.extent.shape, model.node_count, -1)
        size = size.flatten(-2)[..., None, free]
        N = size.mT * torch.linalg.svd(G.detach() * size).Vh[..., G.shape[-2] :, :].mT
    return (
        N
        if near is None and not wants_gradient(G)
        else N - G.mT @ torch.linalg.solve(G @ G.mT, G @ N)
    )
