"""The index-reduced form: the equations of `residuals` differentiated once in time and solved for
the state's rates.

With y = [F; M], z = [V; Omega], q = [u; theta] the rows of the chain are
    root   -A_1 y_1'                                       = a_1 + q^_1' - q_1'
    i+1    -A_i y_i' - A_{i+1} y_{i+1}'                     = a_i + a_{i+1} + q_i' - q_{i+1}'
    i+1    G+_i y_i' + B_i z_i'' + G-_{i+1} y_{i+1}' + B_{i+1} z_{i+1}'' = c+_i + c-_{i+1} + load'
    tip    G+_N y_N' + B_N z_N'' = c+_N + load';             q^_{N+1}' = q_N' + A_N y_N' + a_N
Compatibility is lower and equilibrium upper bidiagonal. Since f^+ - f^- = 2 R y for equilibrium and
q^_{i+1} + q^_i = 2 q_i for compatibility, both sweeps are alternating sums, O(N) without a linear
solve but S^-1 and Mass^-1, which are constant. `block_system` builds the same rows as one matrix.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..core.functions_of_time import rate_along
from ..math import wiener_milenkovic as rot
from ..math.dense import solve_unchecked
from ..math.quaternions import skew
from ..math.shapes import broadcast_shapes, stacked
from .algebra import backward, cross, halves, mtv, mv, six
from .kinematics import Motion, motion, node_rates, nodes, strain_rates
from .model import MixedModel, Places
from .residuals import Element, e1, element, jump_at, with_tip
from .state import Fields, pack


class Terms(NamedTuple):
    """Lower-order terms of every row (..., N, 3), common to both routes to the rates.

    EF, EM      R ~W F, R ~W M: the part of (R F)', (R M)' without F', M'
    T_u, T_psi  rates of the inertia terms without F', M', V'', Omega''
    a_u, a_theta  rates of h R (e1 + gamma), h Q^-1 C^ab kappa without gamma', kappa'
    """

    e: Element
    k: Motion
    jump: Tensor | None
    EF: Tensor
    EM: Tensor
    T_u: Tensor
    T_psi: Tensor
    a_u: Tensor
    a_theta: Tensor
    u_nodes: Tensor
    theta_nodes: Tensor
    line: Tensor
    nodal: Tensor


def terms(model: MixedModel, t: Tensor, x: Fields) -> Terms:
    """R' = R ~W, so (h R j)' = h R (~W j + j') for every vector j of the element's axes.

    The derivation's brackets omega_dot C^T .. + 2 C_dot^T .. + C_ddot^T .. are T_u and T_psi: they
    add up to this, and neither omega_dot nor theta_ddot is left.
    """
    e = element(model, x)
    k = motion(model, t, x.u, x.theta, x.V, x.Omega)
    jump = jump_at(model, x, e, t)
    u_nodes, theta_nodes = node_rates(model, t, k, jump)
    stretch = e1(x.u) + e.gamma
    j_u = cross(x.Omega, e.P) + e.P_dot
    j_psi = cross(x.Omega, e.H) + e.H_dot + cross(x.V, e.P) - cross(stretch, x.F)
    j_u_dot = cross(x.Omega_dot, e.P) + cross(x.Omega, e.P_dot)
    j_psi_dot = (cross(x.Omega_dot, e.H) + cross(x.Omega, e.H_dot)
                 + cross(x.V_dot, e.P) + cross(x.V, e.P_dot))  # fmt: skip
    turning = rot.Q_inverse_rate(x.theta, k.theta_dot)
    return Terms(
        e,
        k,
        jump,
        EF=mv(e.R, cross(k.W, x.F)),
        EM=mv(e.R, cross(k.W, x.M)),
        T_u=e.h * mv(e.R, cross(k.W, j_u) + j_u_dot),
        T_psi=e.h * mv(e.R, cross(k.W, j_psi) + j_psi_dot),
        a_u=e.h * mv(e.R, cross(k.W, stretch)),
        a_theta=e.h * mv(turning, mv(e.Cab, e.kappa)),
        u_nodes=u_nodes,
        theta_nodes=theta_nodes,
        **_load_rates(model, t, x, e, k, u_nodes, theta_nodes),
    )


def _load_rates(
    model: MixedModel, t: Tensor, x: Fields, e: Element, k: Motion, u_dot: Tensor, theta_dot: Tensor
) -> dict[str, Tensor]:
    """`u_dot`, `theta_dot` (..., N+1, 3) of the nodes."""
    axes = model.frames, torch.zeros_like(model.frames)
    u = torch.zeros_like(model.nodes)
    if model.turning or model.shifting:
        at = nodes(model, t, x.u, x.theta)
        u = with_tip(at.u, x.u_tip)
        if model.turning:
            axes = rate_along(model.node_axes, (with_tip(at.theta, x.theta_tip),), (theta_dot,))
    R_dot = e.R @ skew(k.W) if model.changing else e.R
    line, nodal = model.load_rates(
        t,
        Places(e.R, x.u, x.V, x.Omega, axes[0], u),
        Places(R_dot, k.u_dot, x.V_dot, x.Omega_dot, axes[1], u_dot),
    )
    return dict(line=line, nodal=nodal)


def sweep(model: MixedModel, x: Fields, s: Terms) -> Tensor:
    """x' (..., 24 N + 12) by the two sweeps.

    Forward: q^' along the chain, and y' = S^-1 [gamma'; kappa'] from the differences q' - q^'.
    Backward, with W_i = f^+_i' and E = [R F; R M]:  W_N = load',  W_i = load' - W_{i+1} + 2
    E_{i+1}', and h R Mass z'' = W - E' + h line' - T - h R [0; ~F gamma' - (~e1 + ~gamma) F'].
    """
    e, k = s.e, s.k
    du_dot, dtheta_dot = k.u_dot - s.u_nodes[..., :-1, :], k.theta_dot - s.theta_nodes[..., :-1, :]
    gamma_dot, kappa_dot = strain_rates(model, x.theta, k, e.gamma, e.kappa, du_dot, dtheta_dot)
    F_dot, M_dot = halves(mv(model.K, six(gamma_dot, kappa_dot)))

    EF, EM = s.EF + mv(e.R, F_dot), s.EM + mv(e.R, M_dot)
    E = six(EF, EM)
    W = backward(
        s.nodal[..., 1:, :] + 2 * torch.cat((E[..., 1:, :], torch.zeros_like(E[..., :1, :])), -2)
    )
    force, moment = halves(W - E + e.h * s.line)
    stretching = cross(x.F, gamma_dot) - cross(e1(x.F) + e.gamma, F_dot)
    momentum_rates = six(
        mtv(e.R, force - s.T_u) / e.h, mtv(e.R, moment - s.T_psi) / e.h - stretching
    )
    root = (W - 2 * E)[..., 0, :]
    return pack(
        (
            k.u_dot,
            k.theta_dot,
            F_dot,
            M_dot,
            x.V_dot,
            x.Omega_dot,
            *halves(mv(model.Mass_inverse, momentum_rates)),
        ),
        (*halves(root), s.u_nodes[..., -1, :], s.theta_nodes[..., -1, :]),
    )


Blocks = list[tuple[list[int], list[int], Tensor]]  # block rows, block columns, (..., count, 3, 3)


def block_rows(model: MixedModel, x: Fields, s: Terms) -> Blocks:
    """Blocks of A: four rows a node (f_u, f_psi, f_F, f_M), then u', theta', V', Omega'."""
    N, e = model.count, s.e
    S11, S12, S21, S22 = _quarters(model.S)
    M11, M12, M21, M22 = _quarters(model.Mass)
    h, R, F = e.h[..., None], e.R, skew(x.F)
    QC = e.Q_inverse @ e.Cab
    eye = torch.eye(3, dtype=R.dtype, device=R.device).expand(N, 3, 3)
    stretch = skew(e1(x.F) + e.gamma)
    shared = {  # column -> block, the same at both ends of an element
        (0, "V_dot"): h * R @ M11,
        (0, "Omega_dot"): h * R @ M12,
        (1, "F"): h * R @ (F @ S11 - stretch),
        (1, "V_dot"): h * R @ M21,
        (1, "Omega_dot"): h * R @ M22,
        (2, "F"): -h * R @ S11,
        (2, "M"): -h * R @ S12,
        (3, "F"): -h * QC @ S21,
        (3, "M"): -h * QC @ S22,
    }
    twist = h * R @ F @ S12
    ends = {
        -1: {**shared, (0, "F"): -R, (1, "M"): twist - R, (2, "u"): eye, (3, "theta"): eye},
        +1: {**shared, (0, "F"): R, (1, "M"): twist + R, (2, "u"): -eye, (3, "theta"): -eye},
    }
    if s.jump is not None:  # the right end's rotation, in the chart of the element that follows
        jump = torch.cat((s.jump[..., 1:, :, :], eye[:1].expand_as(s.jump[..., :1, :, :])), -3)
        ends[+1] = {at: jump @ block if at[0] == 3 else block for at, block in ends[+1].items()}
    columns = {name: [i * N + j for j in range(N)] for i, name in enumerate(Fields._fields[:8])}
    rows: Blocks = [
        ([4 * (j + (side > 0)) + row for j in range(N)], columns[name], block)
        for side, blocks in ends.items()
        for (row, name), block in blocks.items()
    ]
    last = 4 * N
    ends_columns = (
        (0, 8 * N, -1),
        (1, 8 * N + 1, -1),
        (last + 2, 8 * N + 2, 1),
        (last + 3, 8 * N + 3, 1),
    )
    rows += [([row], [column], sign * eye[:1]) for row, column, sign in ends_columns]
    for i, name in enumerate(("u", "theta", "V", "Omega")):
        rows.append(([4 * (N + 1) + i * N + j for j in range(N)], columns[name], eye))
    return rows


def block_system(model: MixedModel, x: Fields, s: Terms) -> tuple[Tensor, Tensor]:
    """A (..., n, n) and b (..., n) of A x' = b, n = 24 N + 12; rows as in `block_rows`, columns as
    in `Fields`.
    """
    n = 3 * (8 * model.count + 4)
    blocks = block_rows(model, x, s)
    values = stacked(*(b for *_, b in blocks), axis=-3)
    at = torch.tensor(
        [3 * r * n + 3 * c for rows, cols, _ in blocks for r, c in zip(rows, cols, strict=True)]
    )
    inside = torch.tensor([[i * n + j for j in range(3)] for i in range(3)])
    index = (at[:, None, None] + inside).flatten().to(values.device)
    A = (
        values.new_zeros(*values.shape[:-3], n * n)
        .index_copy(-1, index, values.flatten(-3))
        .unflatten(-1, (n, n))
    )
    return A, _right_hand_side(x, s)


def _right_hand_side(x: Fields, s: Terms) -> Tensor:
    """c^-/+ = +/- (R)' y + h line' - T at both ends, a at both ends, and known rates."""
    line, nodal = halves(s.e.h * s.line), halves(s.nodal[..., 1:, :])
    plus, minus = [], []
    for E, T, f, load in zip((s.EF, s.EM), (s.T_u, s.T_psi), line, nodal, strict=True):
        minus.append(E + f - T)
        plus.append(-E + f - T + load)
    a_theta = s.a_theta
    if s.jump is not None:
        a_theta = mv(
            torch.cat((s.jump[..., 1:, :, :], _eye_like(s.jump[..., :1, :, :])), -3), a_theta
        )
    minus += [s.a_u, s.a_theta]
    plus += [s.a_u, a_theta]
    # (..., N, 4, 3)
    minus, plus = (torch.stack(torch.broadcast_tensors(*m), -2) for m in (minus, plus))
    known = torch.stack((s.u_nodes[..., 0, :], s.theta_nodes[..., 0, :]), -2)  # root rates
    first = torch.cat((torch.zeros_like(known), known), -2)[..., None, :, :]
    shape = broadcast_shapes(minus.shape[:-3], first.shape[:-3])
    minus, plus, first = (v.expand(*shape, *v.shape[-3:]) for v in (minus, plus, first))
    nodes = torch.cat((minus, torch.zeros_like(first)), -3) + torch.cat((first, plus), -3)
    rates = pack((s.k.u_dot, s.k.theta_dot, x.V_dot, x.Omega_dot))
    return torch.cat((nodes.flatten(-3), rates.expand(*shape, rates.shape[-1])), -1)


def solve_scaled(A: Tensor, b: Tensor) -> Tensor:
    """A^-1 b with rows, then columns, scaled to a largest entry of one: newton and metre differ by
    many powers of ten. A singular sample yields values that are not finite and leaves its
    neighbours alone.
    """
    row = _largest(A.detach(), -1)  # detached: the scale changes nothing but rounding
    A = A / row
    column = _largest(A.detach(), -2)
    return (solve_unchecked(A / column, b[..., None] / row) / column.mT)[..., 0]


def _largest(matrix: Tensor, dim: int) -> Tensor:
    return torch.maximum(matrix.amax(dim, keepdim=True), -matrix.amin(dim, keepdim=True))


def _quarters(matrix: Tensor) -> tuple[Tensor, ...]:
    return matrix[..., :3, :3], matrix[..., :3, 3:], matrix[..., 3:, :3], matrix[..., 3:, 3:]


def _eye_like(matrix: Tensor) -> Tensor:
    return torch.eye(3, dtype=matrix.dtype, device=matrix.device).expand_as(matrix)
