"""States that satisfy the equations: consistent starts, projection, change of chart; and how they look from outside."""

from __future__ import annotations

import torch
from torch import Tensor

from .. import rotations as rot
from ..checks import Value, as_tensor, finite
from ..scene import Scene
from .algebra import cross, crossing, halves, mv, rotation_nodes
from .chain import Chain, Places
from .kinematics import motion, node_rates, nodes
from .minimal import balance
from .residuals import residual
from .state import Fields, MixedState

LIMIT = 6.0  # |theta| beyond which a state's parameters are rescaled: 225 degrees, back to |theta| = 2.7


def consistent(chain: Chain, t: Tensor, u: Tensor, theta: Tensor, V: Tensor, Omega: Tensor) -> Fields:
    """The state of the block rate form that satisfies every undifferentiated equation at these u, theta, V, Omega: F, M
    from compatibility, accelerations and the root's load from equilibrium, the tip from the recursion.
    """
    found = balance(chain, t, u, theta, V, Omega)
    ends = (*halves(found.root), found.nodes.u[..., -1, :], found.nodes.theta[..., -1, :])
    return Fields(u, theta, *halves(found.stress), V, Omega, *halves(found.acceleration), *ends)


def at_rest(chain: Chain, t: Tensor) -> tuple[Tensor, ...]:
    """u, theta, V, Omega (..., N, 3) undeformed and at rest in frame a: it moves with the frame."""
    shape = torch.broadcast_shapes(chain.scene.batch_shape, chain.middle.shape[:-2])
    zero = chain.middle.new_zeros(*shape, chain.count, 3)
    v, omega = (zero if x is None else x for x in chain.frame(t))
    velocity = v + cross(omega, chain.middle)
    return (zero, zero, *torch.broadcast_tensors(*(mv(chain.Cab.mT, x + zero) for x in (velocity, omega))))


def drift(chain: Chain, t: Tensor, x: Fields) -> Tensor:
    """(...) largest violation of the undifferentiated equations, in N, N m, m and rotation parameters alike."""
    return residual(chain, t, x).detach().abs().amax((-3, -2, -1))


def rescaled(chain: Chain, t: Tensor, theta: Tensor) -> Tensor | None:
    """theta with the elements beyond |theta| = LIMIT in their other chart; None where there is none.

    The element's two *nodes* change chart (`rotations.shadow`) and theta is their mean again: neighbours then see the same
    nodes as before. (Changing theta itself would shift every node beyond it, alternately to either side.)
    """
    over = theta.detach().norm(dim=-1, keepdim=True) > LIMIT
    if not over.any():
        return None
    root = chain.root(t)[1]
    left = rotation_nodes(theta, root, crossing(theta, root))[..., :-1, :]
    left, right = (torch.where(over, n, torch.ones_like(n)) for n in (left, 2 * theta - left))
    return torch.where(over, (rot.shadow(left) + rot.shadow(right)) / 2, theta)


def observe(chain: Chain, t: Tensor, x: Fields, strain: Tensor, status: Tensor) -> MixedState:
    """Positions, velocities, rotations and spins of the nodes, and the reaction: frame a, absolute."""
    k = motion(chain, t, x.u, x.theta, x.V, x.Omega)
    at = nodes(chain, t, x.u, x.theta)
    u_dot, theta_dot = node_rates(chain, t, k, at.jump)
    u, theta = (torch.cat((n[..., :-1, :], tip[..., None, :]), -2)
                for n, tip in ((at.u, x.u_tip), (at.theta, x.theta_tip)))
    position = chain.nodes + u
    v, omega = chain.frame(t)
    velocity = u_dot if v is None else u_dot + v
    velocity = velocity if omega is None else velocity + cross(omega, position)
    spin = mv(rot.turn(theta) @ rot.Q(theta), theta_dot)
    spin = spin if omega is None else spin + omega
    rotation = chain.node_axes(theta)
    nodal = chain.loads(t, Places(k.R, x.u, x.V, x.Omega, rotation, u))[1]
    reaction = torch.cat((x.F_root, x.M_root), -1) - nodal[..., 0, :]
    shape = status.shape
    values = (*x, strain, position, velocity, rotation, spin, reaction)
    single = {"F_root", "M_root", "u_tip", "theta_tip", "reaction"}  # one axis at the end; others two, rotations three
    names = [n for n in MixedState.__dataclass_fields__ if n not in ("t", "status")]
    axes = {name: 1 if name in single else 3 if name == "rotation" else 2 for name in names}
    full = {n: v.expand(*shape, *v.shape[v.ndim - axes[n]:]) for n, v in zip(names, values, strict=True)}
    return MixedState(**full, t=t.expand(shape), status=status)


def consistent_state(
    scene: Scene,
    u: Value | None = None,
    theta: Value | None = None,
    V: Value | None = None,
    Omega: Value | None = None,
    t: float | Tensor = 0.0,
    form: str = "minimal",
    inputs: dict[str, Tensor] | None = None,
) -> MixedState:
    """A consistent state for any u m, theta (frame a), V m/s, Omega rad/s (section axes, absolute) of the elements
    (..., N, 3), and the loads at time t; what is not given is undeformed and at rest in frame a.

    Raises ValueError for a wrong shape or a scene that the form does not take.
    """
    chain = Chain(scene, form, {} if inputs is None else inputs)
    t = torch.as_tensor(t, dtype=scene.dtype, device=scene.device)
    rest = at_rest(chain, t)
    given = []
    for name, value, default in zip(("u", "theta", "V", "Omega"), (u, theta, V, Omega), rest, strict=True):
        value = default if value is None else finite(name, as_tensor(value, scene.dtype, scene.device))
        if value.shape[-2:] != (chain.count, 3):
            raise ValueError(f"{name} of shape {tuple(value.shape)} was given; (..., {chain.count}, 3) is wanted")
        given.append(value)
    return complete(chain, t, torch.broadcast_tensors(*given))


def complete(chain: Chain, t: Tensor, minimal: tuple[Tensor, ...], status: Tensor | None = None) -> MixedState:
    """MixedState from u, theta, V, Omega."""
    found = balance(chain, t, *minimal)
    x = consistent(chain, t, *minimal)
    if status is None:
        status = torch.zeros(found.stress.shape[:-2], dtype=torch.long, device=found.stress.device)
    return observe(chain, t, x, found.strain, status)
