"""The undifferentiated equations of the mixed element: the one truth of both mixed forms.

Hodges' mixed formulation for a chain of N elements (as in GEBT and GXBeam.jl), clamped at node 1.
Everything else in this package is a rearrangement or a derivative of what stands here, and is
tested against it. `side` is -1 for the equations of an element's left end ("-"), +1 for those of
its right end ("+").
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..math import wiener_milenkovic as rot
from ..math.shapes import broadcast_shapes
from .algebra import chart_jump, cross, crossing, forward, halves, mtv, mv, rotation_nodes, six
from .model import MixedModel
from .state import Fields


class Element(NamedTuple):
    """Variables of the six equations, of every element at once (..., N, ...): h, C^ab,
    R = C^T C^ab, Q^-1, and vectors.
    """

    h: Tensor
    Cab: Tensor
    R: Tensor
    Q_inverse: Tensor
    gamma: Tensor
    kappa: Tensor
    P: Tensor
    H: Tensor
    P_dot: Tensor
    H_dot: Tensor


def element(model: MixedModel, x: Fields) -> Element:
    """[gamma; kappa] = S [F; M],  [P; H] = Mass [V; Omega],  R = C^T C^ab."""
    return Element(
        model.h,
        model.Cab,
        rot.turn(x.theta) @ model.Cab,
        rot.Q_inverse(x.theta),
        *halves(mv(model.S, six(x.F, x.M))),
        *halves(mv(model.Mass, six(x.V, x.Omega))),
        *halves(mv(model.Mass, six(x.V_dot, x.Omega_dot))),
    )


def e1(like: Tensor) -> Tensor:
    return torch.tensor((1.0, 0.0, 0.0), dtype=like.dtype, device=like.device)


def f_u(side: int, e: Element, x: Fields, f: Tensor) -> Tensor:
    """Force (..., N, 3) N, frame a:  +/- R F - h f + h R (~Omega P + P_dot);  f N/m.

    The inertia is ~omega R P + d/dt(R P), which is R (~Omega P + P_dot) exactly: no rate of C is
    needed.
    """
    return side * mv(e.R, x.F) - e.h * f + e.h * mv(e.R, cross(x.Omega, e.P) + e.P_dot)


def f_psi(side: int, e: Element, x: Fields, m: Tensor) -> Tensor:
    """Moment (..., N, 3) N m, frame a:  +/- R M - h m + h R (~Omega H + H_dot + ~V
    P - (~e1 + ~gamma) F);  m N.
    """
    inertia = cross(x.Omega, e.H) + e.H_dot + cross(x.V, e.P)
    return side * mv(e.R, x.M) - e.h * m + e.h * mv(e.R, inertia - cross(e1(x.F) + e.gamma, x.F))


def f_F(side: int, e: Element, x: Fields) -> Tensor:
    """Displacement (..., N, 3) m, frame a:  -/+ u - h (R (e1 + gamma) - C^ab e1)."""
    return -side * x.u - e.h * (mv(e.R, e1(x.u) + e.gamma) - e.Cab[..., 0])


def f_M(side: int, e: Element, x: Fields) -> Tensor:
    """Rotation (..., N, 3):  -/+ theta - h Q^-1 C^ab kappa."""
    return -side * x.theta - e.h * mv(e.Q_inverse, mv(e.Cab, e.kappa))


def f_P(e: Element, x: Fields, u_dot: Tensor, v: Tensor, omega: Tensor) -> Tensor:
    """R V - v - ~omega u - u_dot; v m/s is the frame's velocity at the element's reference."""
    return mv(e.R, x.V) - v - cross(omega, x.u) - u_dot


def f_H(e: Element, x: Fields, theta_dot: Tensor, omega: Tensor) -> Tensor:
    """Omega - R^T omega - C^ba Q theta_dot."""
    return x.Omega - mtv(e.R, omega) - mtv(e.Cab, mv(rot.Q(x.theta), theta_dot))


def residual(model: MixedModel, t: Tensor, x: Fields) -> Tensor:
    """The equations f_u, f_psi, f_F, f_M of the nodes 1..N+1, node by node: (..., N+1, 4, 3).

    root      f_u^- = F_root,  f_psi^- = M_root;        f_F^- = u^_1(t),  f_M^- = theta^_1(t)
    between   f_u^+ + f_u^- = load, likewise f_psi;     f_F^+ + f_F^- = 0, likewise f_M
    tip       f_u^+ = load, f_psi^+ = load;             f_F^+ + u_tip = 0,  f_M^+ + theta_tip = 0

    Rotation parameters of neighbours in different charts are compared in the right one's.
    """
    e = element(model, x)
    u_root, theta_root = model.root(t)
    other = crossing(x.theta, theta_root)
    nodes = with_tip(rotation_nodes(x.theta, theta_root, other), x.theta_tip)
    u_nodes = with_tip(forward(u_root, x.u), x.u_tip) if model.shifting else x.u
    line, nodal = model.loads(t, model.places(e.R, x.u, x.V, x.Omega, nodes, u_nodes))
    (f, m), (force, moment) = halves(line), halves(nodal)

    equations = zip(
        (f_u(-1, e, x, f), f_psi(-1, e, x, m), f_F(-1, e, x), f_M(-1, e, x)),
        (f_u(+1, e, x, f), f_psi(+1, e, x, m), f_F(+1, e, x), _arriving(f_M(+1, e, x), other)),
        (
            x.F_root,
            x.M_root,
            u_root,
            theta_root if other is None else _in_chart(theta_root, other[..., 0]),
        ),
        (
            force[..., 1:, :],
            moment[..., 1:, :],
            _only_tip(-x.u_tip, model),
            _only_tip(-x.theta_tip, model),
        ),
        strict=True,
    )
    return torch.stack(torch.broadcast_tensors(*(_nodes(*four) for four in equations)), -2)


def _nodes(minus: Tensor, plus: Tensor, at_root: Tensor, at_right: Tensor) -> Tensor:
    """minus_1 - at_root;  plus_i + minus_{i+1} - at_right_i;  plus_N - at_right_N."""
    plus = plus - at_right
    shape = broadcast_shapes(minus.shape, plus.shape, (*at_root.shape[:-1], *minus.shape[-2:]))
    minus, plus = minus.expand(shape), plus.expand(shape)
    inner = plus[..., :-1, :] + minus[..., 1:, :]
    return torch.cat((minus[..., :1, :] - at_root[..., None, :], inner, plus[..., -1:, :]), -2)


def with_tip(nodes: Tensor, tip: Tensor) -> Tensor:
    return torch.cat((nodes[..., :-1, :], tip[..., None, :].expand_as(nodes[..., :1, :])), -2)


def _only_tip(value: Tensor, model: MixedModel) -> Tensor:
    last = torch.zeros(model.count, 1, dtype=value.dtype, device=value.device)
    last[-1] = 1
    return last * value[..., None, :]


def _in_chart(theta: Tensor, other: Tensor) -> Tensor:
    safe = torch.where(other[..., None], theta, torch.ones_like(theta))
    return torch.where(other[..., None], rot.shadow(safe), theta)


def _arriving(plus: Tensor, other: Tensor | None) -> Tensor:
    """f_M^+ = -(rotation at the right end), in the chart of the element that follows."""
    if other is None:
        return plus
    return torch.cat((-_in_chart(-plus[..., :-1, :], other[..., 1:]), plus[..., -1:, :]), -2)


def jump_at(model: MixedModel, x: Fields, e: Element, t: Tensor) -> Tensor | None:
    """Derivative of the change of chart on entering each element; None = no change."""
    _, root = model.root(t)
    other = crossing(x.theta, root)
    if other is None:
        return None
    ends = x.theta + e.h * mv(e.Q_inverse, mv(e.Cab, e.kappa))
    return chart_jump(
        torch.cat((root.expand_as(ends[..., 0, :])[..., None, :], ends[..., :-1, :]), -2), other
    )
