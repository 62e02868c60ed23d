"""States of the mixed forms: the letters of the block rate form, its flat vector, and what a
simulation returns.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.arguments import place
from ..core.leaves import leaf
from ..state.instant import Instant, Point


class Fields(NamedTuple):
    """x of the block rate form, in the derivation's order.

    of the elements (..., N, 3): u m, theta -, frame a; F N, M N m, V m/s, Omega rad/s and their
    accelerations, frame B of the ends (..., 3), frame a: F_root N, M_root N m (all load on node 1:
    the reaction, and loads put there), u_tip m, theta_tip
    """

    u: Tensor
    theta: Tensor
    F: Tensor
    M: Tensor
    V: Tensor
    Omega: Tensor
    V_dot: Tensor
    Omega_dot: Tensor
    F_root: Tensor
    M_root: Tensor
    u_tip: Tensor
    theta_tip: Tensor


def pack(elements: tuple[Tensor, ...], ends: tuple[Tensor, ...] = ()) -> Tensor:
    """Named parts -> one vector: u of all elements, theta of all elements, ..., then the ends."""
    elements = torch.broadcast_tensors(*elements)
    flat = [e.flatten(-2) for e in elements]
    return torch.cat([*flat, *(e.expand(*flat[0].shape[:-1], 3) for e in ends)], -1)


def unpack(x: Tensor, N: int) -> Fields:
    """(..., 24 N + 12) -> Fields."""
    elements = x[..., : 24 * N].unflatten(-1, (8, N, 3)).unbind(-3)
    return Fields(*elements, *x[..., 24 * N :].unflatten(-1, (4, 3)).unbind(-2))


def unpack_minimal(x: Tensor, N: int) -> tuple[Tensor, ...]:
    """(..., 12 N) -> u, theta, V, Omega (..., N, 3)."""
    return x.unflatten(-1, (4, N, 3)).unbind(-3)


@dataclass(frozen=True, repr=False)
class MixedState(Instant):
    """The beam at one instant in a mixed form. Leading axes are batch axes (time first in a
    trajectory).

    The fields of `Fields` stand first, then quantities that follow from them. The recursion
    n_{i+1} = 2 q_i - n_i gives the nodes from the elements. It does not damp short waves, so
    velocities of inner nodes are rough.

    Attributes:
        strain: (..., N, 6) [gamma kappa] of the elements, frame B
        position: (..., N+1, 3) m, of the nodes, frame a
        velocity: (..., N+1, 3) m/s, absolute, of the nodes, frame a
        rotation: (..., N+1, 3, 3) of the nodes, section axes -> a
        spin: (..., N+1, 3) rad/s, absolute, of the nodes, frame a
        reaction: (..., 6) load of the support on the beam, frame a, N and N m
        t: (...) s
        status: (...) int, 0 = success, see `torchbeam.core.status.STATUS`

    Examples:
        >>> state = tb.consistent_state(scene)
        >>> state.F.shape, state.V.shape  # of the elements
        (torch.Size([4, 3]), torch.Size([4, 3]))
    """

    u: Tensor = leaf(2)
    theta: Tensor = leaf(2)
    F: Tensor = leaf(2)
    M: Tensor = leaf(2)
    V: Tensor = leaf(2)
    Omega: Tensor = leaf(2)
    V_dot: Tensor = leaf(2)
    Omega_dot: Tensor = leaf(2)
    F_root: Tensor = leaf(1)
    M_root: Tensor = leaf(1)
    u_tip: Tensor = leaf(1)
    theta_tip: Tensor = leaf(1)
    strain: Tensor = leaf(2)
    position: Tensor = leaf(2)
    velocity: Tensor = leaf(2)
    rotation: Tensor = leaf(3)
    spin: Tensor = leaf(2)
    reaction: Tensor = leaf(1)
    t: Tensor = leaf(0)
    status: Tensor = leaf(0)

    @property
    def fields(self) -> Fields:
        return Fields(*(getattr(self, name) for name in Fields._fields))

    @property
    def vector(self) -> Tensor:
        """x (..., 24 N + 12) of the block rate form."""
        x = self.fields
        return pack(x[:8], x[8:])

    def node(self, index: int) -> Point:
        """One node's motion, in frame a; counted from the root, -1 is the tip. Raises ValueError
        where there is none such.
        """
        index = place("node", index, self.position.shape[-2], "the beam has the nodes")
        axes = (self.position, self.velocity, self.spin)
        position, velocity, spin = (a[..., index, :] for a in axes)
        return Point(position, velocity, self.rotation[..., index, :, :], spin)

    @property
    def batch_shape(self) -> torch.Size:
        return self.position.shape[:-2]
