"""Mass, damping and tangent stiffness of small motions about an equilibrium, of the moves that the supports leave free.

With T = [I, A] the centre's move by a node's displacement and spin, J and H = J omega in frame a, and omega of frame a:

    M = T^T M T + J      D = T^T 2 M ~omega T + J ~omega + ~omega J - ~H
    K = T^T M ~omega ~omega T + ~omega (J ~omega - ~H) + ...

beside damping, elasticity, stress and loads: gyroscopic, and softened by the rotation.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..scene import Scene
from ..state import State
from . import external
from .external import Chain
from .model import Model, times
from .still import Shape, Still

Blocks = tuple[Tensor, Tensor | None, Tensor | None]  # (..., N+1, w, w) of the nodes, (..., N, w, w) to the next and back


def matrices(model: Model, state: State, t: Tensor, inputs: dict[str, Tensor]) -> tuple[Tensor, Tensor | None, Tensor]:
    """M, D (None without damping or rotation) and K (..., n, n) of the n free moves at an equilibrium, see `moves`."""
    M, D, K = (None if blocks is None else dense(model, *blocks) for blocks in chains(model, state, t, inputs))
    M, K = torch.broadcast_tensors(M, K)
    return (M, None, K) if D is None else torch.broadcast_tensors(M, D, K)


def chains(model: Model, state: State, t: Tensor, inputs: dict[str, Tensor]) -> tuple[Blocks, Blocks | None, Blocks]:
    """The same as block tridiagonal chains of all nodes."""
    space, inertia, p = model.space, model.inertia, model.space.position
    state = space.enter(state)
    x = Shape(state.position, state.rotation, state.stress)
    problem = Still(model, t, inputs, torch.ones_like(t))
    omega = problem.frame[1]
    kin = space.kinematics(x.position, x.rotation, model.length)
    B = space.strain_operator(kin, model.length)
    hB = (model.length[..., None] * B).mT
    K = space.to_blocks(space.geometric_stiffness(kin, x.stress, model.length) + hB @ times(model.C, B))
    D = None if model.rate is None else space.to_blocks(hB @ times(model.C, times(model.rate, B)))

    eye = torch.eye(p, dtype=B.dtype, device=B.device)
    arm = None if inertia.offset is None else inertia.arm(x.rotation)
    turn = None if arm is None else space.arm(arm)
    M = _blocks(inertia.blocks(eye, arm, turn))
    if inertia.inertia is not None:
        R = space.spin_matrix(x.rotation)
        J = R @ inertia.inertia @ R.mT
        M = _add(M, pad(J, (p, 0, p, 0)))
    if omega is not None:
        tilde, hat = space.tilde(omega), space.hat(omega)
        K = _sum(_add(K, pad(problem.inertia(x)[1], (p, 0, p, 0))), _blocks(inertia.blocks(tilde @ tilde, arm, turn)))
        gyroscopic = _blocks(inertia.blocks(2 * tilde, arm, turn))
        if inertia.inertia is not None:
            H = space.hat((J @ omega[..., None])[..., 0])
            gyroscopic = _add(gyroscopic, pad(J @ hat + hat @ J - H, (p, 0, p, 0)))
        D = gyroscopic if D is None else _sum(D, gyroscopic)
    moving = model.loads[0]
    if moving:
        nodes = problem.nodes(x)
        tilde = torch.zeros_like(eye) if omega is None else tilde
        still = Chain(tilde, torch.zeros_like(eye[:space.spin, :space.spin]), tilde @ tilde)
        if model.adds_mass:
            M = _add(M, external.added_mass(model, nodes, t, inputs))
        at = external.tangent(model, nodes, t, inputs, moving, still)
        K = _add(K, -at)
        if any(model.reads(load) & {"velocity", "spin"} for load in moving):
            moved = Chain(tilde + eye, torch.eye(space.spin, dtype=B.dtype, device=B.device), tilde @ tilde + 2 * tilde)
            drag = at - external.tangent(model, nodes, t, inputs, moving, moved)
            D = (drag, None, None) if D is None else _add(D, drag)
    return M, D, K


def without_lag(scene: Scene, name: str, *, moved: bool = False) -> None:
    """ValueError where a load has internal states (`moved`: and reads the motion): M, D and K have no place for them."""
    for load in scene.loads:
        if getattr(load, "internal", 0) and (load.reads(scene.beam) or not moved):
            raise ValueError(f"{type(load).__name__} with internal states was given to {name}, which has no place for them; a "
                             "load without them is wanted")


def moves(model: Model, free: Tensor) -> Tensor:
    """Free moves (..., n) -> displacement and spin of all nodes (..., N+1, 6), frame a, zero where held."""
    at = model.held.moving.flatten()
    whole = free.new_zeros(*free.shape[:-1], at.numel())
    whole = whole.index_copy(-1, at.nonzero()[:, 0], free).unflatten(-1, (model.count + 1, -1))
    if model.space.unknowns == 6:
        return whole
    to = model.space.whole(torch.eye(model.space.unknowns, dtype=model.length.dtype, device=free.device)).to(free.dtype)
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
    free = model.held.moving.flatten().nonzero()[:, 0]
    return A.flatten(-4, -3).flatten(-2).index_select(-1, free).index_select(-2, free)


def _blocks(pair: tuple[Tensor, Tensor | None]) -> Blocks:
    at, between = pair
    return (at, None, None) if between is None else (at, between[..., 0, :, :], between[..., -1, :, :])


def _add(blocks: Blocks, diagonal: Tensor) -> Blocks:
    return blocks[0] + diagonal, *blocks[1:]


def _sum(a: Blocks, b: Blocks) -> Blocks:
    return tuple(x if y is None else y if x is None else x + y for x, y in zip(a, b, strict=True))
