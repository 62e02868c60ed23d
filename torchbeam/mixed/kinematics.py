"""Kinematics of the mixed element: axes, rates, strains and nodes from (u, theta, V, Omega) at time
t.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..math import wiener_milenkovic as rot
from .algebra import chart_jump, cross, crossing, forward, mtv, mv, rotation_nodes
from .model import MixedModel
from .residuals import e1


class Motion(NamedTuple):
    """Of the elements (..., N, ...): R = C^T C^ab; Q^-1; W = Omega - R^T omega, angular velocity
    seen in frame a; rates.
    """

    R: Tensor
    Q_inverse: Tensor
    W: Tensor
    u_dot: Tensor
    theta_dot: Tensor


def motion(
    model: MixedModel, t: Tensor, u: Tensor, theta: Tensor, V: Tensor, Omega: Tensor
) -> Motion:
    """f_P = 0 and f_H = 0 solved:  u_dot = R V - v_i - ~omega u,  theta_dot = Q^-1 C^ab W;
    v_i = v + ~omega x_i.
    """
    R, Q_inverse = rot.turn(theta) @ model.Cab, rot.Q_inverse(theta)
    v, omega = model.frame(t)
    W = Omega if omega is None else Omega - mtv(R, omega)
    u_dot = mv(R, V)
    u_dot = u_dot if v is None else u_dot - v
    u_dot = u_dot if omega is None else u_dot - cross(omega, model.middle + u)
    return Motion(R, Q_inverse, W, u_dot, mv(Q_inverse, mv(model.Cab, W)))


class Nodes(NamedTuple):
    """Displacements and rotation parameters (..., N+1, 3) of the nodes, rotations as seen by the
    element on their right; `jump` where that changes the chart, see `algebra.chart_jump`.
    """

    u: Tensor
    theta: Tensor
    jump: Tensor | None


def nodes(model: MixedModel, t: Tensor, u: Tensor, theta: Tensor) -> Nodes:
    """n_{i+1} = 2 q_i - n_i from the root: f_F^+ and f_F^- (f_M^+ and f_M^-) subtracted."""
    u_root, theta_root = model.root(t)
    other = crossing(theta, theta_root)
    theta_nodes = rotation_nodes(theta, theta_root, other)
    jump = None
    if other is not None:
        ends = 2 * theta - theta_nodes[..., :-1, :]
        jump = chart_jump(
            torch.cat(
                (theta_root.expand_as(theta[..., 0, :])[..., None, :], ends[..., :-1, :]), -2
            ),
            other,
        )
    return Nodes(forward(u_root, u), theta_nodes, jump)


def node_rates(
    model: MixedModel, t: Tensor, k: Motion, jump: Tensor | None
) -> tuple[Tensor, Tensor]:
    """d/dt of `nodes` (..., N+1, 3)."""
    u_root_dot, theta_root_dot = model.root_rates(t)
    return forward(u_root_dot, k.u_dot), forward(theta_root_dot, k.theta_dot, jump)


def strains(
    model: MixedModel, theta: Tensor, R: Tensor, du: Tensor, dtheta: Tensor
) -> tuple[Tensor, Tensor]:
    """f_F^- = u^ and f_M^- = theta^ solved:  gamma = R^T (du/h + C^ab e1) - e1,  kappa = C^ba Q
    dtheta/h, with du = u_i - u^_i, dtheta = theta_i - theta^_i: from an element's left end to its
    middle.
    """
    gamma = mtv(R, du / model.h + model.Cab[..., 0]) - e1(du)
    return gamma, mtv(model.Cab, mv(rot.Q(theta), dtheta / model.h))


def strain_rates(
    model: MixedModel,
    theta: Tensor,
    k: Motion,
    gamma: Tensor,
    kappa: Tensor,
    du_dot: Tensor,
    dtheta_dot: Tensor,
) -> tuple[Tensor, Tensor]:
    """f_F^- and f_M^- differentiated and solved:  gamma_dot = R^T du_dot/h - ~W (e1 + gamma),
    kappa_dot = C^ba Q (dtheta_dot/h - (Q^-1)_dot C^ab kappa).
    """
    gamma_dot = mtv(k.R, du_dot / model.h) - cross(k.W, e1(gamma) + gamma)
    turning = mv(rot.Q_inverse_rate(theta, k.theta_dot), mv(model.Cab, kappa))
    return gamma_dot, mtv(model.Cab, mv(rot.Q(theta), dtheta_dot / model.h - turning))
