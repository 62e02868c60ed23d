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
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.derivatives import cached, no_derivatives
from ..core.leaves import Tree, leaf, map_leaves
from ..core.validation import concrete
from ..equations.steady import Configuration
from ..math import quaternions as quat
from ..math.shapes import broadcast_shapes
from ..nodal.coordinates.spatial import Spatial
from ..scene.parts import Part
from ..state.state import State
from .spinning import Bearing, SpinningProblem
from .system_matrices import of_nodes, rigid_constraints

MET = 1e-6  # of the structure's size: blades that are turned onto each other
RANK = 1e-9  # of the largest singular value


@dataclass(frozen=True)
class SpinningModel(Tree):
    """M, D, K (..., n, n) of coordinates g that do not spin, at psi = 0: of supports, and b.

    M_r, D_r, K_r (..., m, m) of the rotor, r = B g at psi = 0, B (..., m, n);  S (..., m, m)
    moves (..., w nodes, n): of all nodes by g, at psi = 0
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
    order: int
    bladed: bool
    harmonics: int

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
    bearing: Bearing, problem: SpinningProblem, x: Configuration, state: State, speed: Tensor
) -> SpinningModel:
    """About a steady spin at speeds (...)."""
    model, space = bearing.model, bearing.model.space
    M, D, K, _ = of_nodes(model, state, problem.t, problem.inputs, problem)
    G, G_other = _constraints(bearing, rigid_constraints(K))
    M, K = M.dense(), K.dense()
    D = torch.zeros_like(K) if D is None else D.dense()
    lead = broadcast_shapes(*(A.shape[:-2] for A in (M, D, K)), speed.shape)
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
    order, P, bladed = _symmetry(bearing, X)
    S_b = _generator(P, Z_b, size, order)
    if S_b is None:
        order, S_b = 0, Z_b.new_zeros(*lead, Z_b.shape[-1], Z_b.shape[-1])
    Z, moves = torch.cat((Z_y, Z_b), -1), torch.cat((Z_s + Z_y @ Y, Z_b), -1)
    eye = torch.eye(Z_b.shape[-1], dtype=M.dtype, device=M.device)
    B = block_diagonal(Y, eye.expand(*lead, *eye.shape))
    own = torch.eye(B.shape[-1], dtype=B.dtype, device=B.device)
    if bearing.others:
        own = _null_space(G_other @ moves)
        B, moves = B @ own, moves @ own
    M_g, D_g, K_g = (moves.mT @ A @ moves for A in (M, D, K))
    if bearing.damping is not None:
        row = own[..., Y.shape[-1] - 1, None, :]
        damper = bearing.damper(speed, problem.t)[..., None, None]
        D_g = D_g + damper * row.mT @ row
    return SpinningModel(
        speed.expand(lead),
        M_g,
        D_g,
        K_g,
        *(Z.mT @ A @ Z for A in (M, D, K)),
        B,
        block_diagonal(X, S_b),
        moves,
        order,
        bladed,
        2 * max(1, (order - 1) // 2),
    )


def block_diagonal(A: Tensor, B: Tensor) -> Tensor:
    """[A, 0; 0, B] of (..., m, n) and (..., k, l)."""
    (m, n), (k, l) = A.shape[-2:], B.shape[-2:]
    return pad(A, (0, l, 0, k)) + pad(B, (n, 0, m, 0))


def _constraints(bearing: Bearing, G: Tensor) -> tuple[Tensor, Tensor]:
    """Of all constraints (..., m, w nodes) those within the rotor and within what stands, and those
    of the rotor's other bearings.
    """
    joint = bearing.model.joints.held.nonzero()[:, 0].tolist()
    joint += [-1] * (G.shape[-2] - len(joint))
    own = [k for k, at in enumerate(joint) if at not in (bearing.joint, *bearing.others)]
    others = [k for k, at in enumerate(joint) if at in bearing.others]
    return G[..., own, :], G[..., others, :]


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


def _symmetry(bearing: Bearing, X: Tensor) -> tuple[int, Tensor | None, bool]:
    """By which part of a turn the rotor comes onto itself, three or more; how that moves moves
    (..., w nodes, w nodes), X (..., w, w) axis x ...; and whether parts lie off the axis. (0,
    None, True) where it does not.
    """
    beam = bearing.model.scene.beam
    nodes = beam.nodes.detach().reshape(-1, *beam.nodes.shape[-2:])
    parts = [part for part in beam.parts if bearing.rotor[part.nodes.start]]
    point, axis = (v.detach().reshape(-1, 3) for v in (bearing.point, bearing.direction))
    apart = nodes - point[:, None, :]
    near = MET * beam.extent.detach().reshape(-1)
    for order in range(len(parts) + 2, 2, -1):
        turn = quat.matrix(quat.exponential(axis * (2 * math.pi / order)))
        turned = (turn[:, None] @ apart[..., None])[..., 0]
        images = [_image(part, parts, apart, turned, near) for part in parts]
        if None in images:
            continue
        turn = torch.linalg.matrix_exp(X * (2 * math.pi / order))
        moved = any(a is not b for a, b in zip(parts, images, strict=True))
        return order, _permutation(bearing, parts, images, turn), moved
    return 0, None, True


def _image(part: Part, parts: list[Part], nodes: Tensor, turned: Tensor, near: Tensor) -> Any:
    """The part that this is turned onto, itself first; None = there is none."""
    for other in (part, *parts):
        if other.node_count == part.node_count and other.body == part.body:
            off = torch.linalg.vector_norm(
                turned[:, part.nodes] - nodes[:, other.nodes], dim=-1
            ).amax(-1)
            if bool(concrete(off <= near).all()):
                return other
    return None


def _permutation(bearing: Bearing, parts: list[Part], images: list[Part], turn: Tensor) -> Tensor:
    """(..., w nodes, w nodes): a node's moves, turned (..., w, w), as those of its image."""
    count = bearing.model.node_count
    places = torch.zeros(count, count, dtype=turn.dtype, device=turn.device)
    for part, image in zip(parts, images, strict=True):
        for k in range(part.node_count):
            places[image.nodes.start + k, part.nodes.start + k] = 1.0
    return (places[:, None, :, None] * turn[..., None, :, None, :]).flatten(-4, -3).flatten(-2)


def _generator(P: Tensor | None, Z: Tensor, size: Tensor, order: int) -> Tensor | None:
    """S (..., n, n) of moves Z (..., w nodes, n), orthonormal by their size; None where P does not
    take these to themselves, as joints hold others.
    """
    if P is None:
        return None
    own = Z / size[..., None]
    turned = P @ own
    P, S, power = own.mT @ turned, torch.zeros_like(own.mT @ own), own.mT @ own
    if bool(concrete((turned - own @ P).abs() > MET).any()):
        return None
    for j in range(1, order):
        power = power @ P
        angles = ((k, 2 * math.pi * j * k / order) for k in range(1, (order + 1) // 2))
        S = S + sum(2 * k * math.sin(angle) for k, angle in angles) / order * power
    return S
