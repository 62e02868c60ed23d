"""Sensor of the position of a point at any arc length, on the axis or off it: a marker."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core.validation import Value, as_tensor, axis_last, concrete, finite
from ..math import quaternions as quat
from ..math.shapes import broadcast_shapes
from ..scene.beam import Beam
from ..scene.scene import Scene
from ..state.state import State
from .along import _Along
from .sensor import XYZ


@dataclass(frozen=True, eq=False, repr=False)
class Position(_Along):
    """Position (..., 3) m, frame a, of a point that moves with a section, like a motion capture
    marker.

    Args:
        station: (...) m, arc length from the root at rest, 0 to the beam's length
        beam: the `Beam`, or its `Scene`
        point: (..., 3) m, in section axes (x along the beam), from the axis
        on: name of the beam, in a structure, whose `Scene` is then given as the beam

    Between two nodes the axis is the cubic of their positions and tangents (Hermite). The tangents
    are those of the mean strain between the nodes, an arc to the fourth order in their distance.
    Sections turn evenly from one node to the other. It is differentiable by the state, the station
    and the point. Its rate, by `observe(rate=True)`, is the point's velocity.

    Raises:
        ValueError: for a station beyond the beam, and as `Strain` does.

    Examples:
        >>> marker = tb.sensors.Position(0.6, beam, point=(0, 0, 0.02))
        >>> marker(solution.state)[-1]  # m
        tensor([0.5859, 0.0000, 0.1103])
    """

    beam: Beam | Scene | None = None
    element: int | None = field(default=None, init=False)
    point: Value = (0.0, 0.0, 0.0)
    arclength: Tensor | None = field(default=None, init=False)
    what: ClassVar[str] = "position"
    unit = "m"
    labels = XYZ
    transforms_as = "point"

    def __post_init__(self) -> None:
        super().__post_init__()
        length = self.beam.length
        point = axis_last("point", as_tensor(self.point, length.dtype, length.device), 3)
        arclength = self.beam.topology.arclength(length)
        vars(self).update(point=finite("point", point), arclength=arclength)

    def read(self, state: Any) -> Tensor:
        position = state.position
        if isinstance(state, State):
            rotation = state.rotation
        else:
            R = [state.node(k).rotation for k in range(position.shape[-2])]
            rotation = quat.from_matrix(torch.stack(R, -3))
        shape = broadcast_shapes(self.station.shape, self.arclength.shape[:-1])
        s, at = self.arclength, self.station.expand(shape)[..., None]
        s = s.expand(*shape, s.shape[-1])
        k = torch.searchsorted(s[..., 1:-1].detach().contiguous(), at.detach().contiguous())
        start, h = s.gather(-1, k), s.diff(dim=-1).gather(-1, k)
        (a, p), (b, q) = ((_row(position, k + i), _row(rotation, k + i)) for i in (0, 1))
        return _interpolated(a, b, p, quat.nearer(q, p), h, (at - start) / h, self.point)


def _row(values: Tensor, k: Tensor) -> Tensor:
    """Row k (..., 1) of values (..., rows, w)."""
    if concrete(k).numel() == 1:  # the same of all samples
        return values[..., int(concrete(k)), :]
    shape = broadcast_shapes(values.shape[:-2], k.shape[:-1])
    values = values.expand(*shape, *values.shape[-2:])
    k = k.expand(*shape, 1)[..., None].expand(*shape, 1, values.shape[-1])
    return values.gather(-2, k)[..., 0, :]


def _interpolated(
    a: Tensor, b: Tensor, p: Tensor, q: Tensor, h: Tensor, x: Tensor, point: Tensor
) -> Tensor:
    """Position of a point of the section at the share x (..., 1) of the way from a to b (..., 3),
    whose sections are turned by p, q (..., 4), h (..., 1) m apart along the axis.

    tangents  R_p e and R_q e with e = R_m^T (b - a)/h (1 + phi^2/24), R_m half way, phi the turn:
              of an arc, whose chord is shorter than itself by phi^2/24
    """
    turn = quat.logarithm(quat.multiply(quat.conjugate(p), q))
    longer = 1 + turn.square().sum(-1, keepdim=True) / 24
    e = quat.rotate(quat.conjugate(quat.half_way(p, q)), (b - a) * longer)
    t_a, t_b = quat.rotate(p, e), quat.rotate(q, e)
    rise = b - a - t_a
    axis = a + x * (t_a + x * (3 * rise - (t_b - t_a) + x * (t_b - t_a - 2 * rise)))
    return axis + quat.rotate(quat.multiply(p, quat.exponential(x * turn)), point)
