"""Small motions about a steady spin, in coordinates that do not spin.

With q_R = Z r the moves of the rotor's nodes in axes that turn with it: r = (y, b), y those of the
bearing's point, which carry the whole rotor, and b the blades' beside it. In these axes

    M_r r'' + D_r r' + K_r r = 0

is constant. Coordinates that do not spin are s = exp(psi S) r, psi = W t, with S = axis x ... on y:
these are then moves in frame a, those of the support's node. On b, S is the generator of the
blades' cyclic symmetry (the multiblade, or Coleman, transform: Coleman and Feingold 1958, NACA
Report 1351; Hohenemser and Yin 1972, J. Am. Helicopter Soc. 17(3), 3): with P the permutation of B
equal blades, turned by 2 pi/B, and Pi_k the projection on its harmonic k,

    P = exp(2 pi/B S)        S = sum over |k| < B/2 of i k Pi_k = sum_j c_j P^j

    M = M_r    D = D_r - 2 W M_r S    K = K_r - W D_r S + W^2 M_r S^2

of s are constant as well, where all of these commute with S: for three and more equal blades. For
others each is exp(psi S) (...) exp(-psi S), periodic; two blades and unequal ones keep their own
axes, S = 0 on b.

Internal states of loads, and what elements have crept by, are coordinates without inertia behind b,
see `system_matrices`: numbers of a section's axes, which P takes from blade to blade as they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import cached, no_derivatives
from ..core.leaves import Tree, leaf, map_leaves
from ..core.validation import concrete
from ..equations.steady import Configuration, SteadyProblem
from ..math.block_matrices import block_diagonal, with_identity
from ..math.shapes import broadcast_shapes
from ..nodal.coordinates.spatial import Spatial
from ..state.state import State
from .bearing import Bearing
from .cyclic_symmetry import generator, symmetry
from .system_matrices import of_nodes, rigid_constraints, with_states

RANK = 1e-9  # of the largest singular value


@dataclass(frozen=True)
class SpinningModel(Tree):
    """M, D, K (..., n, n) of coordinates g that do not spin, at psi = 0: of supports, and b.

    M_r, D_r, K_r (..., m, m) of the rotor, r = B g at psi = 0, B (..., m, n);  S (..., m, m)
    moves (..., w nodes, n): of all nodes by g, at psi = 0;  Z (..., w nodes, m): of the rotor's
            by r
    states  how many internal states come last, of g and of r
    order   by which part of a turn the rotor comes onto itself, 0 = by none from a third on
    bladed  whether parts of the rotor lie off the axis
    harmonics  highest one of M, D, K in psi
    """

    speed: Tensor = leaf(0)
    M: Tensor = leaf(2)
    D: Tensor = leaf(2)
    K: Tensor = leaf(2)
    M_r: Tensor = leaf(2)
    D_r: Tensor = leaf(2)
    K_r: Tensor = leaf(2)
    B: Tensor = leaf(2)
    S: Tensor = leaf(2)
    moves: Tensor = leaf(2)
    Z: Tensor = leaf(2)
    order: int
    bladed: bool
    harmonics: int
    nodes: int
    states: int = 0

    @cached
    def mechanical(self) -> SpinningModel:
        """Of the moves alone."""
        if not self.states:
            return self
        square = {
            name: getattr(self, name) for name in ("M", "D", "K", "M_r", "D_r", "K_r", "B", "S")
        }
        cut = {name: X[..., : -self.states, : -self.states] for name, X in square.items()}
        cut |= {name: getattr(self, name)[..., : -self.states] for name in ("moves", "Z")}
        return replace(self, **cut, states=0)

    def moves_at(self, psi: Tensor) -> Tensor:
        """Those of all nodes by g (s, ..., w nodes, n), frame a, at azimuths psi (s,)."""
        w, psi = self.moves.shape[-2] // self.nodes, psi.reshape(-1, *(1,) * self.S.ndim)
        turn = torch.linalg.matrix_exp(psi * self.S[..., :w, :w])[..., None, :, :]
        moves = self.Z @ torch.linalg.matrix_exp(-psi * self.S) @ self.B
        moves = (turn @ moves.unflatten(-2, (self.nodes, w))).flatten(-3, -2)
        return self.moves - self.Z @ self.B + moves

    def at(self, k: int | slice | tuple[int, ...]) -> SpinningModel:
        """Of one speed, of some, or of one sample of one."""
        return map_leaves(lambda x, axes: x[k], self)

    def constant(self) -> tuple[Tensor, Tensor, Tensor]:
        """M, D, K of blades that are equal, or of a psi of 0."""
        W, S, B = self.speed[..., None, None], self.S, self.B
        D = self.D - 2 * W * B.mT @ self.M_r @ S @ B
        return self.M, D, self.K + B.mT @ (W**2 * self.M_r @ S - W * self.D_r) @ S @ B

    def periodic(self, psi: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """M, D, K (s, ..., n, n) at azimuths psi (s,). They have harmonics up to twice those of S,
        so that their values at as many azimuths tell all.
        """
        count = len(self._samples[0])
        at = torch.arange(count).to(psi) * (2 * math.pi / count)
        d = torch.arange(1, count // 2 + 1).to(psi)
        share = (1 + 2 * torch.cos(d * (psi[:, None] - at)[..., None]).sum(-1)) / count
        M, D, K = (torch.einsum("sj,j...->s...", share, X) for X in self._samples)
        return M, D, K

    @cached
    def _samples(self) -> tuple[Tensor, Tensor, Tensor]:
        """M, D, K (2 h + 1, ..., n, n) at as many azimuths, of harmonics up to h = `harmonics`."""
        W, S, M = self.speed[..., None, None], self.S, self.M_r
        of_rotor = M, self.D_r - 2 * W * M @ S, self.K_r + (W**2 * M @ S - W * self.D_r) @ S
        count = 2 * self.harmonics + 1
        turns = [torch.linalg.matrix_exp(2 * math.pi * j / count * S) for j in range(count)]
        turns, samples = torch.stack(turns), []
        for X, constant in zip(of_rotor, self.constant(), strict=True):
            samples.append(constant + self.B.mT @ (turns @ X @ turns.mT - X) @ self.B)
        M, D, K = samples
        return M, D, K


def spinning_model(
    bearing: Bearing, problem: SteadyProblem, x: Configuration, state: State, speed: Tensor
) -> SpinningModel:
    """About a steady spin at speeds (...)."""
    model, space = bearing.model, bearing.model.space
    M, D, K, lags = of_nodes(model, state, problem.t, problem.inputs, problem)
    G, G_other = _constraints(bearing, rigid_constraints(K))
    M, K = M.dense(), K.dense()
    D = torch.zeros_like(K) if D is None else D.dense()
    lead = broadcast_shapes(*(A.shape[:-2] for A in (M, D, K)), speed.shape)
    states = model.lag_count
    if lags is not None:
        M, D, K = with_states(M, D, K, lags)
    axis, w = bearing.axis(x), space.unknowns
    centre = bearing.reduced(x, axis.point)
    node = torch.arange(model.node_count, device=M.device).repeat_interleave(w)
    rotor, free = bearing.rotor[node], model.constraints.moving.flatten()
    size = model.unit[..., None, :].expand(*model.extent.shape, model.node_count, -1).flatten(-2)
    Z_s = _held_by(G, free & ~rotor, size, lead)
    Z_b = _held_by(G, rotor & (node != bearing.hub), size, lead)
    Z_y = _rigid(space, x.position - centre[..., None, :]).flatten(-3, -2)
    Z_y = (rotor[:, None] * Z_y).expand(*lead, *Z_y.shape[-2:])
    Y = Z_s.new_zeros(*lead, w, Z_s.shape[-1])
    if bearing.support is not None:
        at = bearing.support
        lever = _rigid(space, (centre - x.position[..., at, :])[..., None, :])[..., 0, :, :]
        Y = lever @ Z_s[..., at * w : (at + 1) * w, :]
    unit = space.project_spin(axis.direction)
    if bearing.damping is not None:  # a turn of the rotor in its bearing, behind the support's
        turn = pad(unit, (w - unit.shape[-1], 0))[..., None].expand(*lead, w, 1)
        Z_s, Y = pad(Z_s, (0, 1)), torch.cat((Y, turn), -1)
    X = block_diagonal(space.skew(unit), space.spin_skew(unit)).expand(*lead, w, w)
    order, P, bladed = symmetry(bearing, X)
    Z_b, size = with_identity(Z_b, states), pad(size, (0, states), value=1.0)
    S_b = generator(P, Z_b, size, order)
    if S_b is None:
        order, S_b = 0, Z_b.new_zeros(*lead, Z_b.shape[-1], Z_b.shape[-1])
    Z_y, Z_s = (pad(A, (0, 0, 0, states)) for A in (Z_y, Z_s))
    Z, moves = torch.cat((Z_y, Z_b), -1), torch.cat((Z_s + Z_y @ Y, Z_b), -1)
    B = with_identity(Y, Z_b.shape[-1])
    free_moves = torch.eye(B.shape[-1], dtype=B.dtype, device=B.device)
    if bearing.others:
        of_moves = moves[..., : len(node), : moves.shape[-1] - states]
        free_moves = with_identity(_null_space(G_other @ of_moves), states)
        B, moves = B @ free_moves, moves @ free_moves
    M_g, D_g, K_g = (moves.mT @ A @ moves for A in (M, D, K))
    if bearing.damping is not None:
        row = free_moves[..., Y.shape[-1] - 1, None, :]
        damper = bearing.damper(speed, problem.t)[..., None, None]
        D_g = D_g + damper * row.mT @ row
        if bearing.inertia is not None:
            M_g = M_g + bearing.inertia[..., None, None] * row.mT @ row
    return SpinningModel(
        speed.expand(lead),
        M_g,
        D_g,
        K_g,
        *(Z.mT @ A @ Z for A in (M, D, K)),
        B,
        block_diagonal(X, S_b),
        moves[..., : len(node), :],
        Z[..., : len(node), :],
        order,
        bladed,
        2 * max(1, (order - 1) // 2),
        model.node_count,
        states,
    )


def _constraints(bearing: Bearing, G: Tensor) -> tuple[Tensor, Tensor]:
    """Of all constraints (..., m, w nodes) those within the rotor and within what stands, and those
    of the rotor's other bearings.
    """
    joint = bearing.model.joints.held.nonzero()[:, 0].tolist()
    joint += [-1] * (G.shape[-2] - len(joint))
    within = [k for k, at in enumerate(joint) if at not in (bearing.joint, *bearing.others)]
    others = [k for k, at in enumerate(joint) if at in bearing.others]
    return G[..., within, :], G[..., others, :]


def _rigid(space: Spatial, lever: Tensor) -> Tensor:
    """(..., n, w, w): moves of points at a lever (..., n, p) by those of what carries them."""
    A = space.lever_matrix(lever)
    p, s = A.shape[-2:]
    eye = torch.eye(p + s, dtype=A.dtype, device=A.device)
    return eye + pad(A, (p, 0, 0, s))


def _held_by(G: Tensor, mask: Tensor, size: Tensor, lead: tuple[int, ...]) -> Tensor:
    """(..., w nodes, n) moves of those in the mask that leave what G (..., m, w nodes) holds,
    orthonormal by their size.
    """
    at = mask.nonzero()[:, 0]
    size = size[..., at]
    G = (G[..., at] * size[..., None, :]).expand(*lead, G.shape[-2], len(at))
    used = (concrete(G.detach()) != 0).flatten(0, -3).any(0).any(-1)
    N = size[..., None] * _null_space(G[..., used, :])
    return N.new_zeros(*lead, len(mask), N.shape[-1]).index_copy(-2, at, N)


def _null_space(G: Tensor) -> Tensor:
    """(..., n, n - rank) orthonormal, of G (..., m, n)."""
    n = G.shape[-1]
    if not G.shape[-2]:
        return torch.eye(n, dtype=G.dtype, device=G.device).expand(*G.shape[:-2], n, n)
    with no_derivatives():
        values, V = torch.linalg.svd(G)[1:]
        rank = (values > RANK * values.amax(-1, keepdim=True)).sum(-1)
        N, back = V[..., int(concrete(rank).amax()) :, :].mT, torch.linalg.pinv(G)
    return N - back @ (G @ N)  # no more than its derivative
