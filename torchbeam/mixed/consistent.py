"""Consistent states: initial states, projection, change of chart, and their motion in frame a."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.arguments import choice, instance, instant
from ..core.validation import Value, as_tensor, finite, refusal
from ..math import wiener_milenkovic as rot
from ..math.shapes import broadcast_shapes
from ..scene.scene import Scene
from .algebra import cross, crossing, halves, mtv, mv, rotation_nodes
from .kinematics import motion, node_rates, nodes
from .minimal import balance
from .model import MixedModel, Places
from .residuals import residual
from .state import Fields, MixedState

# |theta| beyond which a state's parameters are rescaled: 225 degrees, back to |theta| = 2.7
LIMIT = 6.0


def consistent(
    model: MixedModel, t: Tensor, u: Tensor, theta: Tensor, V: Tensor, Omega: Tensor
) -> Fields:
    """The state of the block rate form that satisfies every undifferentiated equation at these u,
    theta, V, Omega: F, M from compatibility, accelerations and the root's load from equilibrium,
    the tip from the recursion.
    """
    rates = balance(model, t, u, theta, V, Omega)
    ends = (*halves(rates.root), rates.nodes.u[..., -1, :], rates.nodes.theta[..., -1, :])
    return Fields(u, theta, *halves(rates.stress), V, Omega, *halves(rates.acceleration), *ends)


def at_rest(model: MixedModel, t: Tensor) -> tuple[Tensor, ...]:
    """u, theta, V, Omega (..., N, 3) undeformed and at rest in frame a, with which it moves, but
    for the root's node, which is where its support has it, and moves so: of the first element,
    whose two nodes' mean they are, half of that.
    """
    placed, moving = model.root(t), model.root_rates(t)
    # its motion may have batch axes of its own
    root = (x.shape[:-1] for x in (*placed, *moving))
    shape = broadcast_shapes(model.scene.batch_shape, model.middle.shape[:-2], *root)
    zero = model.middle.new_zeros(*shape, model.count, 3)
    v, omega = (zero if x is None else x for x in model.frame(t))
    clamp = model.scene.supports[0]
    if clamp.displacement is None and clamp.turn is None:
        velocity = v + cross(omega, model.middle)
        V, Omega = (mv(model.Cab.mT, x + zero) for x in (velocity, omega))
        return zero, zero, *torch.broadcast_tensors(V, Omega)
    first = (torch.arange(model.count, device=zero.device) == 0).to(zero)[:, None] / 2
    u, theta, u_dot, theta_dot = (zero + first * x[..., None, :] for x in (*placed, *moving))
    velocity = v + cross(omega, model.middle + u) + u_dot
    turned = mv(model.Cab.mT, mv(rot.Q(theta), theta_dot))
    R = rot.turn(theta) @ model.Cab
    V, Omega = mtv(R, velocity), turned + mtv(R, omega + zero)
    return u, theta, *torch.broadcast_tensors(V, Omega)


def drift(model: MixedModel, t: Tensor, x: Fields) -> Tensor:
    """(...) largest violation of the undifferentiated equations: N, N m, m, rotation parameters."""
    return residual(model, t, x).detach().abs().amax((-3, -2, -1))


def rescaled(model: MixedModel, t: Tensor, theta: Tensor) -> Tensor | None:
    """theta with the elements beyond |theta| = LIMIT in their other chart; None where there is
    none.

    The element's two *nodes* change chart (`rotations.shadow`) and theta is their mean again:
    neighbours then see the same nodes as before. (Changing theta itself would shift every node
    beyond it, alternately to either side.)
    """
    over = theta.detach().norm(dim=-1, keepdim=True) > LIMIT
    if not over.any():
        return None
    root = model.root(t)[1]
    left = rotation_nodes(theta, root, crossing(theta, root))[..., :-1, :]
    left, right = (torch.where(over, n, torch.ones_like(n)) for n in (left, 2 * theta - left))
    return torch.where(over, (rot.shadow(left) + rot.shadow(right)) / 2, theta)


def observe(model: MixedModel, t: Tensor, x: Fields, strain: Tensor, status: Tensor) -> MixedState:
    """Positions, velocities, rotations, spins of nodes, and the reaction: frame a, absolute."""
    k = motion(model, t, x.u, x.theta, x.V, x.Omega)
    at = nodes(model, t, x.u, x.theta)
    u_dot, theta_dot = node_rates(model, t, k, at.jump)
    u, theta = (
        torch.cat((n[..., :-1, :], tip[..., None, :]), -2)
        for n, tip in ((at.u, x.u_tip), (at.theta, x.theta_tip))
    )
    position = model.nodes + u
    v, omega = model.frame(t)
    velocity = u_dot if v is None else u_dot + v
    velocity = velocity if omega is None else velocity + cross(omega, position)
    spin = mv(rot.turn(theta) @ rot.Q(theta), theta_dot)
    spin = spin if omega is None else spin + omega
    rotation = model.node_axes(theta)
    nodal = model.loads(t, Places(k.R, x.u, x.V, x.Omega, rotation, u))[1]
    reaction = torch.cat((x.F_root, x.M_root), -1) - nodal[..., 0, :]
    shape = status.shape
    values = (*x, strain, position, velocity, rotation, spin, reaction)
    # one axis at the end; others two, rotations three
    single = {"F_root", "M_root", "u_tip", "theta_tip", "reaction"}
    names = [n for n in MixedState.__dataclass_fields__ if n not in ("t", "status")]
    axes = {name: 1 if name in single else 3 if name == "rotation" else 2 for name in names}
    full = {
        n: v.expand(*shape, *v.shape[v.ndim - axes[n] :])
        for n, v in zip(names, values, strict=True)
    }
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
    """A consistent state for any u m, theta (frame a), V m/s, Omega rad/s of the elements (..., N,
    3), under the loads at t. V and Omega are absolute, in section axes. By default the beam is
    undeformed and at rest in frame a.

    Raises:
        ValueError: for a wrong shape or a scene that the form does not take.

    Examples:
        >>> V = torch.zeros(4, 3)
        >>> V[:, 2] = torch.linspace(0, 1, 4)  # m/s, of four elements
        >>> tb.consistent_state(scene, V=V).V[-1]
        tensor([0., 0., 1.])
    """
    instance("a scene", scene, Scene)
    choice("form", form, ("minimal", "block_rate"))
    model = MixedModel(scene, form, {} if inputs is None else inputs)
    t = instant("t", t, scene.beam.nodes)
    rest = at_rest(model, t)
    terms = []
    for name, value, default in zip(
        ("u", "theta", "V", "Omega"), (u, theta, V, Omega), rest, strict=True
    ):
        value = (
            default if value is None else finite(name, as_tensor(value, scene.dtype, scene.device))
        )
        if value.shape[-2:] != (model.count, 3):
            raise refusal(f"{name} of shape {tuple(value.shape)}", f"(..., {model.count}, 3)")
        terms.append(value)
    return complete(model, t, torch.broadcast_tensors(*terms, rest[0])[:4])


def complete(
    model: MixedModel, t: Tensor, minimal: tuple[Tensor, ...], status: Tensor | None = None
) -> MixedState:
    """MixedState from u, theta, V, Omega."""
    rates = balance(model, t, *minimal)
    x = consistent(model, t, *minimal)
    if status is None:
        status = torch.zeros(rates.stress.shape[:-2], dtype=torch.long, device=rates.stress.device)
    return observe(model, t, x, rates.strain, status)
