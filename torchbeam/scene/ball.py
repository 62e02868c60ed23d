"""Ball: a joint that leaves all turns about a point."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..core.declared import own, parameter, plain, together
from ..core.leaves import leaf
from ..core.validation import Value, concrete, finite, positive, refusal
from .effects.values import OfTime, load_value
from .joint import VECTOR, CoordinateLaw, Joint

SYMMETRIC = 1e-6  # of the largest number of a matrix: how far it may be from its transposed


def _matrix(name: str, value: Any) -> Tensor | np.ndarray:
    """(..., 3, 3) of a stiffness; ValueError where it is none."""
    value = plain(value)
    if tuple(value.shape[-2:]) != (3, 3):
        value = parameter(name, value)
        same = torch.eye(3, dtype=value.dtype) if isinstance(value, Tensor) else np.eye(3)
        return value[..., None, None] * (same.to(value) if isinstance(value, Tensor) else same)
    K = concrete(torch.as_tensor(value)).detach()
    finite(name, K)
    size = K.abs().amax((-1, -2), keepdim=True)
    if ((K - K.mT).abs() > SYMMETRIC * size).any():
        raise refusal("a Ball with a stiffness that is not symmetric", "K = K^T")
    least = torch.linalg.eigvalsh(K)[..., :1, None]
    positive(f"{name} along an eigenvector", (least + SYMMETRIC * size), zero=True)
    return own(value)


@dataclass(frozen=True)
class Ball(Joint):
    """Ball joint: b turns about a point of a, in any direction.

    The coordinate is the rotation vector phi (rad) of b as seen from a. It is zero at rest and less
    than half a turn. All numbers are in axes that turn with a, and are frame a's axes at rest.
    Moments of the joint act on b, and their opposites on a.

    Args:
        stiffness: K, N m/rad: one number, or (..., 3, 3), symmetric: the energy phi K phi/2
        damping: (...) c, N m s/rad: the moment -c omega, of the spin omega of b against a
        friction: (...) mu, N m: -mu omega/sqrt(|omega|^2 + s^2), regularised Coulomb friction
        slip_speed: (...) s, rad/s; the joint creeps at speeds far below it
        axis: (..., 3), frame a, undeformed; of any length: the direction of b that swings
        limit: (...) rad, less than pi: half opening of a cone about `axis`; a moment rises beyond
            it
        limit_stiffness: (...) N m/rad of that moment, which rises smoothly over a hundredth of the
            opening
        torque: (..., 3) N m on b, its opposite on a: numbers, a function of t, or an `Input`

    Raises:
        ValueError: for a negative number, a stiffness that is not symmetric or has a negative
            eigenvalue, friction without slip speed, or a limit without stiffness.

    Examples:
        >>> arms = {"upper": beam, "lower": tb.Beam.straight(1.0, 4, strip, root=(1.0, 0, 0))}
        >>> pair = tb.Scene(
        ...     arms,
        ...     joints=[tb.Ball(("upper", -1), ("lower", 0))],
        ...     supports=[tb.Support(("upper", 0))],
        ... )
        >>> tb.rest(pair).joint[0].coordinate  # rad, the rotation vector
        tensor([0., 0., 0.])
    """

    rotation = ""
    coordinates = (0, 1, 2)

    _: KW_ONLY
    stiffness: Value | None = leaf(2, default=None, check=_matrix)
    damping: Value | None = leaf(0, default=None, nonnegative=True, copied=True)
    friction: Value | None = leaf(0, default=None, nonnegative=True, copied=True)
    slip_speed: Value | None = leaf(0, default=None, positive=True, copied=True)
    axis: Value = leaf(1, default=(1.0, 0.0, 0.0), size=3, copied=True, name=VECTOR)
    limit: Value | None = leaf(0, default=None, positive=True, copied=True)
    limit_stiffness: Value | None = leaf(0, default=None, nonnegative=True, copied=True)
    torque: OfTime = leaf(1, default=None, check=load_value)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.limit is not None and concrete(torch.as_tensor(self.limit) >= torch.pi).any():
            raise refusal("a Ball with a limit of half a turn", "less")
        together(self, ("friction", "slip_speed"), ("limit", "limit_stiffness"))

    def turning_resistance(self, length: Tensor) -> Tensor | None:
        return None if self.stiffness is None else self.stiffness.abs().amax((-1, -2))

    def law(self, coordinate: int) -> CoordinateLaw:
        """Torque (..., 3) of any coordinate; `BallLaws` has the resistance."""
        return CoordinateLaw(effort=self.torque)
