"""The minimal form: the element's algebra eliminated, states u, theta, V, Omega (12 N), no load
rates, no drift.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from ..scene.effects.damping import geometric_means
from .algebra import backward, cross, halves, mtv, mv, six
from .kinematics import Motion, Nodes, motion, node_rates, nodes, strain_rates, strains
from .model import MixedModel
from .residuals import e1
from .state import pack


class Balance(NamedTuple):
    """Intermediate results of the minimal form, per element (..., N, ...): see `Fields`; `root`
    (..., 6) is all load on node 1, [F_root; M_root].
    """

    k: Motion
    nodes: Nodes
    strain: Tensor
    stress: Tensor
    acceleration: Tensor
    root: Tensor
    nodal: Tensor


def balance(
    model: MixedModel, t: Tensor, u: Tensor, theta: Tensor, V: Tensor, Omega: Tensor
) -> Balance:
    """Strains from f_F = f_M = 0, stress, and the accelerations from f_u = f_psi = 0 by one
    backward sweep.

    [F; M] = S^-1 [gamma; kappa] (+ damping);  with W_i = f^+_i, E = [R F; R M]
    W_N = load,  W_i = load - W_{i+1} + 2 E_{i+1}
    h R (P_dot + ~Omega P) = W - E + h f,  h R (H_dot + ~Omega H + ~V P - (~e1 + ~gamma)
    F) = W - E + h m.
    """
    k = motion(model, t, u, theta, V, Omega)
    at = nodes(model, t, u, theta)
    gamma, kappa = strains(model, theta, k.R, u - at.u[..., :-1, :], theta - at.theta[..., :-1, :])
    strain = six(gamma, kappa)
    stress = mv(model.K, strain) + _damping(model, t, theta, k, at, gamma, kappa)
    F, M = halves(stress)
    P, H = halves(mv(model.Mass, six(V, Omega)))

    line, nodal = model.loads(t, model.places(k.R, u, V, Omega, at.theta, at.u))
    E = six(mv(k.R, F), mv(k.R, M))
    W = backward(
        nodal[..., 1:, :] + 2 * torch.cat((E[..., 1:, :], torch.zeros_like(E[..., :1, :])), -2)
    )
    force, moment = halves((W - E) / model.h + line)
    momentum_rates = six(
        mtv(k.R, force) - cross(Omega, P),
        mtv(k.R, moment) - cross(Omega, H) - cross(V, P) + cross(e1(F) + gamma, F),
    )
    return Balance(
        k, at, strain, stress, mv(model.Mass_inverse, momentum_rates), (W - 2 * E)[..., 0, :], nodal
    )


def rates(
    model: MixedModel, t: Tensor, u: Tensor, theta: Tensor, V: Tensor, Omega: Tensor
) -> Tensor:
    """d/dt of [u, theta, V, Omega] (..., 12 N)."""
    solution = balance(model, t, u, theta, V, Omega)
    return pack((solution.k.u_dot, solution.k.theta_dot, *halves(solution.acceleration)))


def _damping(
    model: MixedModel, t: Tensor, theta: Tensor, k: Motion, at: Nodes, gamma: Tensor, kappa: Tensor
) -> Tensor | float:
    """S^-1 tau strain_dot, or D^1/2 S^-1 D^1/2 strain_dot with D = diag(tau) of six."""
    damping = model.scene.damping
    if damping is None:
        return 0.0
    u_dot, theta_dot = node_rates(model, t, k, at.jump)
    differences = k.u_dot - u_dot[..., :-1, :], k.theta_dot - theta_dot[..., :-1, :]
    strain_dot = six(*strain_rates(model, theta, k, gamma, kappa, *differences))
    tau = damping.tau
    if not damping.six:
        return tau[..., None, None] * mv(model.K, strain_dot)
    return mv(geometric_means(tau)[..., None, :, :] * model.K, strain_dot)
