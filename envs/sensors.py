"""Sensors: what of the beam an observation holds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from torchbeam import State
from torchbeam import quaternions as quat

NAMES = ("tip", "middle", "gauges", "full")
HIGH = {"displacement": 2, "velocity": 20, "curvature": 40, "rotation": np.pi, "spin": 200}
PLANES = {None: (slice(0, 3), slice(0, 3), slice(1, 3)),  # components of vectors, of rotations, of bending
          "xy": (slice(0, 2), slice(2, 3), slice(2, 3)), "xz": (slice(0, 3, 2), slice(1, 2), slice(1, 2))}


class Sensors:
    """What is read off a beam of `elements` elements, in the order of `names`; d = 3 components, or the 2 of `plane`.

    tip     displacement of the tip since the start (d), over the length L; its velocity (d), over L omega
    middle  the same of node elements // 2
    gauges  bending curvature (about y and z; in a plane about its normal) of the first element and of element
            elements // 2, since the start, times L: a strain gauge's reading is that over L, times its distance from the axis
    full    of every node but the clamped one, node by node: displacement (d) and velocity (d) as above, rotation vector since
            the start in section axes (3, or 1 in a plane), spin (likewise) over omega

    Raises ValueError for an unknown name, or for gauges and full with a form other than "nodal".
    """

    def __init__(self, names: str | Sequence[str], elements: int, plane: str | None = None, form: str = "nodal") -> None:
        names = (names,) if isinstance(names, str) else tuple(names)
        if not names or len(set(names)) < len(names) or not set(names) <= set(NAMES):
            raise ValueError(f"sensors = {names!r} was given; one or more of {', '.join(map(repr, NAMES))} are wanted")
        if form != "nodal" and set(names) & {"gauges", "full"}:
            raise ValueError(f"sensors = {names!r} with form = {form!r} was given; that form has 'tip' and 'middle'")
        self.names, self.elements = names, elements
        self.vector, self.turn, self.bending = PLANES[plane]
        d, r, b = (len(range(*part.indices(3))) for part in PLANES[plane])
        point = [*d * ["displacement"], *d * ["velocity"]]
        parts = {"tip": point, "middle": point, "gauges": 2 * b * ["curvature"],
                 "full": elements * [*point, *r * ["rotation"], *r * ["spin"]]}
        kinds = [kind for name in names for kind in parts[name]]
        self.high = np.array([HIGH[kind] for kind in kinds], dtype=np.float32)
        starts = dict(zip(names, np.cumsum([0, *(len(parts[name]) for name in names)]).tolist(), strict=False))
        if "tip" in names:
            self.tip = slice(starts["tip"], starts["tip"] + d)  # where the tip's displacement is; None = not seen
        elif "full" in names:
            end = starts["full"] + len(parts["full"]) - len(parts["full"]) // elements
            self.tip = slice(end, end + d)
        else:
            self.tip = None

    def read(self, beam: State, start: State, length: float, speed: Tensor) -> Tensor:
        """(n, size of `high`): beam and start with the batch (n,), length m, speed = length * omega (n or 1, 1) m/s."""
        return torch.cat([getattr(self, f"_{name}")(beam, start, length, speed) for name in self.names], -1)

    def _point(self, node: int, beam: State, start: State, length: float, speed: Tensor) -> Tensor:
        moved = (beam.position[:, node] - start.position[:, node]) / length
        return torch.cat((moved[:, self.vector], (beam.velocity[:, node] / speed)[:, self.vector]), -1)

    def _tip(self, *seen) -> Tensor:
        return self._point(-1, *seen)

    def _middle(self, *seen) -> Tensor:
        return self._point(self.elements // 2, *seen)

    def _gauges(self, beam: State, start: State, length: float, speed: Tensor) -> Tensor:
        now, then = (self._bent(x.rotation) for x in (beam, start))
        return (now - then).flatten(1) * self.elements

    def _bent(self, rotation: Tensor) -> Tensor:
        """(n, 2, b) rad, by which the two gauged elements are bent; times elements / L it is their curvature."""
        ends = (torch.stack([rotation[:, i + end] for i in (0, self.elements // 2)], 1) for end in (0, 1))
        first, last = ends
        return quat.logarithm(quat.multiply(quat.conjugate(first), last))[..., self.bending]

    def _full(self, beam: State, start: State, length: float, speed: Tensor) -> Tensor:
        moved = (beam.position - start.position)[:, 1:, self.vector] / length
        turned = quat.logarithm(quat.multiply(quat.conjugate(start.rotation[:, 1:]), beam.rotation[:, 1:]))
        rates = beam.velocity[:, 1:, self.vector] / speed[..., None], beam.spin[:, 1:, self.turn] * (length / speed[..., None])
        return torch.cat((moved, rates[0], turned[..., self.turn], rates[1]), -1).flatten(1)
