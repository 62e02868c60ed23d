"""Body: a rigid body in a structure, one node with a mass on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..core.declared import plain
from ..core.leaves import Tree, leaf, option
from ..core.validation import Value, rotations
from ..math import quaternions as quat
from .effects.obstacle import Obstacle, body_surface
from .effects.point_mass import PointMass


@dataclass(frozen=True)
class Body(Tree):
    """A rigid body: one node at its centre of mass.

    Args:
        mass: (...) kg
        inertia: kg m^2 about the centre, in the body's axes: one number (the same about every
            axis), (..., 3) principal moments, or (..., 3, 3), as in `PointMass`. None = a point,
            which something must keep from turning
        position: (..., 3) m of the centre at rest, frame a
        rotation: (..., 3, 3) the body's axes at rest as columns, frame a; None = frame a's axes
        surface: solid shape for a `Contact`, fixed to the body, in its axes: a `Sphere`, `Capsule`,
            `Cylinder` or `Box`. None = a ball of the contact's radius

    Raises:
        ValueError: for a mass that is not positive, an impossible inertia, or axes that are no
            rotation. For a surface of another kind, or with a motion of its own.

    Examples:
        >>> hub = tb.Body(mass=0.5, inertia=0.001, position=(1.0, 0, 0))
        >>> tipped = tb.Scene(
        ...     {"arm": beam, "hub": hub},
        ...     joints=[tb.Weld(("arm", -1), "hub")],
        ...     supports=[tb.Support(("arm", 0))],
        ... )
        >>> tb.modes(tipped, count=1).frequency  # rad/s
        tensor([2.7859])
    """

    # its own: the inertia of a scene is of all of these
    mass: Value = leaf(0, positive=True, copied=True)
    inertia: Value | None = leaf(2, default=None)
    position: Value = leaf(1, default=(0.0, 0.0, 0.0), size=3, copied=True)
    rotation: Value | None = leaf(2, default=None, size=(3, 3), copied=True)
    surface: Obstacle | None = option(body_surface, default=None)

    in_words = "a {}'s {}"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.inertia is not None:
            inertia = plain(self.inertia)
            if inertia.ndim == 0:  # the same about every axis
                inertia = inertia * (
                    torch.eye(3, dtype=inertia.dtype) if isinstance(inertia, Tensor) else np.eye(3)
                )
            elif inertia.shape[-1] != 3:
                raise ValueError(
                    f"a Body's inertia of shape {tuple(inertia.shape)} was given; one number, "
                    "(..., 3) or (..., 3, 3) is wanted (of samples that have J each the same about "
                    "every axis, J[:, None, None] * torch.eye(3))"
                )
            elif isinstance(self.inertia, (list, tuple)):
                inertia = self.inertia
            object.__setattr__(self, "inertia", PointMass(self.mass, inertia).inertia)
        if self.rotation is not None:
            rotations("a Body's rotation", torch.as_tensor(self.rotation))

    @property
    def frame(self) -> Tensor:
        """Quaternion (..., 4), body's axes -> frame a, of a body whose numbers are tensors."""
        if self.rotation is None:
            at = self.position
            return quat.identity(at.shape[:-1], at.dtype, at.device)
        return quat.from_matrix(self.rotation)
