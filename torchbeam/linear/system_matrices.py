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

from ..nodal import loads as external
from ..nodal.constitutive_law import times
from ..nodal.loads import Lags, MotionJacobian
from ..nodal.model import Model
from ..scene.effects import INERTIAL
from ..state.state import State
from ..statics.steady import Configuration, SteadyProblem

Blocks = tuple[Tensor, Tensor | None, Tensor | None]  # (..., N+1, w, w) of the nodes, (..., N, w, w) to the next and back


def matrices(model: Model, state: State, t: Tensor, inputs: dict[str, Tensor]) -> tuple[Tensor, Tensor | None, Tensor]:
    """M, D (None without damping or rotation) and K (..., n, n) at an equilibrium, of the free moves, see `moves`, and the
    internal states of loads.
    """
    M, D, K, lagging = chains(model, state, t, inputs)
    return augmented(model, *(None if blocks is None else dense(model, *blocks) for blocks in (M, D, K)), lagging)


def augmented(model: Model, M: Tensor, D: Tensor | None, K: Tensor, lagging: Lags | None
              ) -> tuple[Tensor, Tensor | None, Tensor]:
    """The same from the matrices of the free moves alone."""
    M, K = torch.broadcast_tensors(M, K)
    if lagging is None:
        return (M, None, K) if D is None else torch.broadcast_tensors(M, D, K)
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    L, (H, H_v, H_a) = lagging.L.index_select(-2, free), (x.index_select(-1, free) for x in lagging[2:])
    D = torch.zeros_like(K) if D is None else D
    shape = torch.broadcast_shapes(*(x.shape[:-2] for x in (M, D, L)))

    def whole(*parts: Tensor) -> Tensor:
        a, b, c, d = (x.expand(*shape, *x.shape[-2:]) for x in parts)
        return torch.cat((torch.cat((a, b), -1), torch.cat((c, d), -1)), -2)

    none, eye = torch.zeros_like(L), torch.eye(L.shape[-1], dtype=L.dtype, device=L.device)
    return (whole(M, none, -H_a, torch.zeros_like(lagging.G)), whole(D, none, -H_v, eye), whole(K, -L, -H, -lagging.G))


def chains(model: Model, state: State, t: Tensor, inputs: dict[str, Tensor]
           ) -> tuple[Blocks, Blocks | None, Blocks, Lags | None]:
    """The same as block tridiagonal chains of all nodes, and what loads with internal states add."""
    space, inertia = model.space, model.inertia
    state = space.to_reduced(state)
    x = Configuration(state.position, state.rotation, state.stress)
    problem = SteadyProblem(model, t, inputs, torch.ones_like(t))
    if model.internal_states:
        problem = problem.holding(x, state.internal)
    omega = problem.frame[1]
    kin = model.kinematics(x.position, x.rotation)
    B = space.strain_operator(kin, model.length)
    hB = (model.length[..., None] * B).mT
    K = space.to_blocks(space.geometric_stiffness(kin, x.stress, model.length) + hB @ times(model.law.C, B))
    D = space.to_blocks(hB @ model.law.damping_by(B)) if model.law.damped else None

    M = _blocks(inertia.matrix(x.rotation))
    if omega is not None:
        lever = problem.lever(x)
        moved, angular = None if lever is None else space.lever_matrix(lever), None
        if inertia.inertia is not None:
            J, turning = inertia.about_centre(x.rotation), space.spin_skew(omega)
            angular = J @ turning + turning @ J - space.spin_skew(problem.momenta(x).angular)
        K = _sum(K, _blocks(problem.inertia_tangent(x)))
        gyroscopic = _blocks(inertia.tangent(inertia.blocks(2 * space.skew(omega), lever, moved), angular, None, None))
        D = gyroscopic if D is None else _sum(D, gyroscopic)
    moving, lagging = model.loads[0], None
    if moving or model.internal_states:
        nodes = problem.nodes(x)
        eye, spins = (torch.eye(n, dtype=B.dtype, device=B.device) for n in (space.position, space.spin))
        turning = torch.zeros_like(eye) if omega is None else space.skew(omega)
        still = MotionJacobian(turning, torch.zeros_like(spins), turning @ turning)
        if model.adds_mass:
            M = _add(M, external.added_mass(model, nodes, t, inputs))
        at = external.tangent(model, nodes, t, inputs, moving, still)
        K = _add(K, -at)
        angular = None if omega is None else space.spin_skew(omega)
        moved = MotionJacobian(turning + eye, spins, turning @ turning + 2 * turning, angular)
        lagging = external.lags(model, nodes, t, inputs, still, moved)
        if model.read & ({"velocity", "spin"} if omega is None else {"velocity", "spin", *INERTIAL}):
            drag = at - external.tangent(model, nodes, t, inputs, moving, moved)
            D = (drag, None, None) if D is None else _add(D, drag)
    return M, D, K, lagging


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


def dense(model: Model, diagonal: Tensor, upper: Tensor | None = None, lower: Tensor | None = None) -> Tensor:
    """(..., n, n) of the free moves, from blocks of all nodes."""
    nodes, w = model.count + 1, model.space.unknowns
    blocks = [diagonal] if upper is None else [diagonal, upper, lower]
    shape = torch.broadcast_shapes(*(x.shape[:-3] for x in blocks))
    A = diagonal.new_zeros(*shape, nodes, w, nodes, w)
    at = torch.arange(nodes, device=diagonal.device)
    diagonal = diagonal.expand(*shape, nodes, w, w)
    A[..., at, :, at, :] = diagonal.movedim(-3, 0)
    if upper is not None:
        upper, lower = (x.expand(*shape, nodes - 1, w, w) for x in (upper, lower))
        A[..., at[:-1], :, at[1:], :] = upper.movedim(-3, 0)
        A[..., at[1:], :, at[:-1], :] = lower.movedim(-3, 0)
    free = model.constraints.moving.flatten().nonzero()[:, 0]
    return A.flatten(-4, -3).flatten(-2).index_select(-1, free).index_select(-2, free)


def _blocks(pair: tuple[Tensor, Tensor | None]) -> Blocks:
    at, between = pair
    return (at, None, None) if between is None else (at, between[..., 0, :, :], between[..., -1, :, :])


def _add(blocks: Blocks, diagonal: Tensor) -> Blocks:
    return blocks[0] + diagonal, *blocks[1:]


def _sum(a: Blocks, b: Blocks) -> Blocks:
    return tuple(x if y is None else y if x is None else x + y for x, y in zip(a, b, strict=True))
