"""A blade, or a tower, as files describe it: a reference axis by points with structural twist, and
6x6 matrices at stations; and the beam that it is.

Files have z along the blade, x towards the suction side (flap, downwind at rest), y towards the
trailing edge (edge), and rows [Fx Fy Fz Mx My Mz]. A beam's section has x along it, y and z across,
and rows [F1 F2 F3 M1 M2 M3]. The one is the other by a cyclic change of names, which is a rotation:

    section x, y, z = file z, x, y

A section's axes are turned by the twist about the negative z axis of the file (IEC).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import count
from ..core.validation import refusal
from ..scene.beam import Beam
from ..scene.beam_arguments import check_order
from ..scene.curve import parabolas
from ..scene.section import Section
from ..scene.stations import Stations, Table, stacked

ORDER = (2, 0, 1, 5, 3, 4)  # of a file's rows, in a section's matrix
ENDS = 1e-4  # how far from 0 and 1 the first and the last station may be


def reordered(matrix: list[list[float]]) -> list[list[float]]:
    """A file's 6x6 matrix in the axes and the order of a section."""
    return [[matrix[i][j] for j in ORDER] for i in ORDER]


def section_of(stiffness: list[list[float]], mass: list[list[float]]) -> Section:
    """The section of 6x6 matrices in its own axes: plain numbers, whose zeros are absent.

    Raises ValueError as `Section`, and for a singular stiffness.
    """
    K = torch.tensor(stiffness, dtype=torch.float64)
    compliance, failed = torch.linalg.inv_ex((K + K.mT) / 2)
    if failed:
        raise refusal("a stiffness that is singular", "a positive one")
    return Section(((compliance + compliance.mT) / 2).tolist(), mass)


@dataclass
class Blade:
    """What a file says.

    Args:
        points: (k, 3) m of the reference axis, in the file's axes at the root
        twist: (k,) rad, structural, of these
        eta: (n,) stations as shares of the axis' length, from 0 to 1
        sections: n of them, in their own axes
        name: of the file, for errors
    """

    points: Tensor
    twist: Tensor
    eta: Tensor
    sections: list[Section]
    name: str

    def beam(self, elements: int | None, order: int) -> Beam:
        """The beam in the file's axes at the root, which become frame a: it runs along z. elements
        = None: a node at each point.

        Raises ValueError for points or stations that do not go from root to tip, or an even number
        of points for elements of order 2.
        """
        check_order(order)
        size = self.points.diff(dim=-2).norm(dim=-1)
        if self.points.shape[-2] < 2 or not (size > 0).all():
            raise refusal(f"an axis with two points at one place in {self.name}", "points apart")
        s = pad(size.cumsum(-1), (1, 0))
        if elements is None:
            nodes_s = s
        else:
            n = count("elements", elements) * order
            nodes_s = torch.linspace(0, 1, n + 1, dtype=s.dtype) * s[-1]
        nodes = Table(s, self.points, width=3)(nodes_s)
        places = (nodes_s[1:] + nodes_s[:-1]) / 2 if order == 1 else nodes_s
        along = nodes.diff(dim=-2) if order == 1 else parabolas(nodes)[1]
        frames = axes(along, Table(s, self.twist)(places))
        return Beam.from_nodes(nodes, self._stations(nodes, nodes_s, order), frames, order)

    def _stations(self, nodes: Tensor, nodes_s: Tensor, order: int) -> Stations:
        """At arc lengths of the beam through `nodes`, whose chords cut the corners of the axis."""
        if abs(self.eta[0]) > ENDS or abs(self.eta[-1] - 1) > ENDS:
            raise refusal(
                f"stations from {self.eta[0]:g} to {self.eta[-1]:g} in {self.name}", "0 to 1"
            )
        if not (self.eta.diff() > 0).all():
            raise refusal(f"stations that do not increase in {self.name}", "0 to 1, increasing")
        length = nodes.diff(dim=-2).norm(dim=-1) if order == 1 else parabolas(nodes)[0]
        if order == 2:  # two stations an element, for half of it each
            length = length.unflatten(-1, (-1, 2)).mean(-1).repeat_interleave(2)
        chords = Table(nodes_s, pad(length.cumsum(-1), (1, 0)))
        eta = torch.cat((self.eta.new_zeros(1), self.eta[1:-1], self.eta.new_ones(1)))
        return Stations(chords(eta * nodes_s[-1]), stacked(self.sections))


def axes(along: Tensor, twist: Tensor) -> Tensor:
    """Section axes (..., 3, 3) as columns: x `along` (..., 3), y and z the file's x and y, square
    to it (the file's y keeps the tangent's plane), turned about the negative tangent by `twist`
    (...) rad.
    """
    t = along / along.norm(dim=-1, keepdim=True)
    x = torch.linalg.cross(t.new_tensor((0.0, 1, 0)).expand_as(t), t)
    if not (x.norm(dim=-1) > 1e-3).all():
        raise refusal("a reference axis along the file's y", "one that runs along z")
    x = x / x.norm(dim=-1, keepdim=True)
    y = torch.linalg.cross(t, x)
    cos, sin = twist.cos()[..., None], twist.sin()[..., None]
    return torch.stack((t, cos * x - sin * y, sin * x + cos * y), -1)
