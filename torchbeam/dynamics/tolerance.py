"""Tolerance of adaptive steps: what rtol and atol are of, and how far two states are apart by
it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import tolerance as check_tolerance
from ..core.leaves import Tree, leaf
from ..core.validation import as_tensor, broadcast, concrete
from ..math import quaternions as quat
from ..scene.scene import Scene
from ..state.state import State


@dataclass(frozen=True)
class Tolerance(Tree):
    """Error that is allowed: `position` (...) m and `rotation` (...) rad.

    With L the length of the beam these are atol + rtol L and rtol + atol/L: a section turned by an
    angle moves what is a beam's length away by L times as much. A tolerance is thus about where the
    beam is, on a scale that does not change as it moves. Velocities are not measured by themselves:
    an error of theirs that lasts is one of positions later on, and what alternates from step to
    step (modes far above what the steps resolve, whose velocity is their frequency times as large
    as their motion) is no motion.
    """

    position: Tensor = leaf(0)
    rotation: Tensor = leaf(0)

    @classmethod
    def of(cls, scene: Scene, rtol: Any, atol: Any) -> Tolerance:
        """Of the scene's beam; rtol is a number or (...) of samples, atol m likewise. Raises
        ValueError for what is negative, zero in both, or beyond the arithmetic.
        """
        rtol, atol = (
            as_tensor(
                check_tolerance(name, 0.0 if value is None else value, zero=True, each=True),
                scene.dtype,
                scene.device,
            )
            for name, value in (("rtol", rtol), ("atol", atol))
        )
        length = concrete(scene.beam.extent).detach()
        broadcast("a beam, rtol and atol", scene.batch_shape, rtol.shape, atol.shape)
        position = atol + rtol * length
        if not (position > 0).all():
            raise ValueError("rtol = 0 and atol = 0 were given; one of them has to be positive")
        least = 16 * torch.finfo(scene.dtype).eps
        if (position < least * length).any():
            raise ValueError(
                f"a tolerance of {(position / length).min().item():.3g} of the beam's length was "
                f"given; {scene.dtype} resolves no less than {least:.2g}"
            )
        return cls(position, position / length)

    def distance(self, a: State, b: State) -> Tensor:
        """The largest distance (...) of nodes and angle between sections of two states, in units of
        the tolerance; infinite where one is not a number.
        """
        apart = torch.linalg.vector_norm(a.position - b.position, dim=-1).amax(-1)
        angle = torch.linalg.vector_norm(
            quat.logarithm(quat.multiply(quat.conjugate(a.rotation), b.rotation)), dim=-1
        ).amax(-1)
        distance = torch.maximum(apart / self.position, angle / self.rotation)
        return torch.where(torch.isfinite(distance), distance, torch.inf)
