"""Arrows: forces, moments and loads along beams, with their numbers, in pictures of beams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from .canvas import Axes, numbers, written_number

HEAD = 0.25  # of an arrow's length: of its head
TURN = 4.5  # rad: of the arc of a moment
FEW = 5e-3  # of the largest: what is less is not drawn
ROW = 9  # arrows along a beam, at most
ABOVE = dict(zorder=4, solid_capstyle="round")


@dataclass(frozen=True)
class Arrows:
    """On axes that show the coordinates `seen`. length: m, of the longest."""

    ax: Axes
    seen: list[int]
    length: float
    color: Any

    def force(self, x: Tensor, F: Tensor, most: float, into: Tensor) -> None:
        """A force F (3) N at x (3) m, with its number: what is seen of it, `most` the longest.
        It pushes at x, or pulls where the beam, which goes `into` (3) from there, lies behind it.
        """
        F = self._seen(F)
        size = F.norm().item()
        if size <= FEW * most:
            return
        u = F / size
        arrow = self.length * (0.4 + 0.6 * size / most) * u
        pulls = (u @ into).item() < -0.5
        start, end = (x, x + arrow) if pulls else (x - arrow, x)
        self._line(torch.stack((start, end)))
        self._head(end, u, HEAD * self.length)
        self._text(end if pulls else start, u if pulls else -u, f"{written_number(size)} N")

    def moment(self, x: Tensor, M: Tensor, most: float) -> None:
        """A moment M (3) N m at x (3) m, an arc about its axis, with its number."""
        if len(self.seen) == 2:
            across = _across(self.seen)
            M = (M @ across) * across
        size = M.norm().item()
        if size <= FEW * most:
            return
        axis, radius = M / size, 0.45 * self.length
        e = normal_to(axis, [0, 1, 2])
        angle = torch.linspace(0, TURN, 41, dtype=x.dtype)[:, None]
        ring = torch.cos(angle) * e + torch.sin(angle) * torch.linalg.cross(axis, e)
        self._line(x + radius * ring)
        along = torch.linalg.cross(axis, ring[-1])
        self._head(x + radius * ring[-1], along, HEAD * self.length)
        self._text(x + radius * ring[20], ring[20], f"{written_number(size)} N m")

    def row(self, x: Tensor, f: Tensor, most: float) -> None:
        """Loads f (n, 3) N/m along a beam at x (n, 3) m, which push at it; numbers at the extremes,
        one where all is the same. They jump where a place comes twice.
        """
        f = self._seen(f)
        size = f.norm(dim=-1)
        if size.max().item() <= FEW * most:
            return
        tails = x - self.length * f / most
        self._line(tails, lw=1.0)
        place = torch.nn.functional.pad((x.diff(dim=0) != 0).any(-1).long(), (1, 0)).cumsum(0)
        last = int(place[-1])
        even = place % (-(-last // (ROW - 1)) or 1) == 0
        at = (even | (place == last)).nonzero()[:, 0]
        for k in at[size[at] > FEW * most].tolist():
            self._line(torch.stack((tails[k], x[k])), lw=1.0)
            self._head(x[k], f[k] / size[k], HEAD * self.length * size[k].item() / most, lw=1.0)
        same = (size.max() - size.min()).item() < 1e-6 * most
        for k in {len(x) // 2} if same else {int(size.argmax()), int(size.argmin())}:
            if size[k] > FEW * most:
                self._text(tails[k], -f[k] / size[k], f"{written_number(size[k].item())} N/m")

    def _seen(self, v: Tensor) -> Tensor:
        """Vectors (..., 3) without what goes out of the plane."""
        kept = torch.zeros(3, dtype=v.dtype)
        kept[self.seen] = 1.0
        return v * kept

    def _line(self, points: Tensor, lw: float = 1.6) -> None:
        self.ax.plot(*numbers(points[:, self.seen]).T, color=self.color, lw=lw, **ABOVE)

    def _head(self, tip: Tensor, u: Tensor, size: float, lw: float = 1.6) -> None:
        """The head of an arrow along u (3)."""
        n = normal_to(u, self.seen)
        wings = [tip - size * (u + side * 0.45 * n) for side in (1, -1)]
        self._line(torch.stack((wings[0], tip, wings[1])), lw)

    def _text(self, x: Tensor, away: Tensor, text: str) -> None:
        """Beside a point, on the side of `away` (3)."""
        where = (x + 0.12 * self.length * away)[self.seen].tolist()
        across, up = away[self.seen][:2].tolist()
        room = x + self.length * away * (0.9 if abs(across) > 0.5 else 0.35)
        self.ax.plot(*numbers(room[self.seen])[:, None], alpha=0)
        ha = "left" if across > 0.5 else "right" if across < -0.5 else "center"
        va = "bottom" if up > 0.5 else "top" if up < -0.5 else "center"
        self.ax.text(*where, text, color=self.color, fontsize=8, ha=ha, va=va, zorder=5)


def _across(seen: list[int]) -> Tensor:
    """The normal of a plane that is seen, by which turns in it are counted."""
    normal = torch.zeros(3, dtype=torch.float64)
    normal[3 - sum(seen)] = -1.0 if seen == [0, 2] else 1.0
    return normal


def normal_to(axis: Tensor, seen: list[int]) -> Tensor:
    """A unit vector at right angles to a unit vector (3), in the plane that is seen."""
    across = _across(seen) if len(seen) == 2 else torch.zeros_like(axis)
    if len(seen) == 3 or torch.linalg.cross(across, axis).norm() < 1e-6:
        across = torch.zeros_like(axis)
        across[axis.abs().argmin()] = 1.0
    return torch.nn.functional.normalize(torch.linalg.cross(across, axis), dim=0)
