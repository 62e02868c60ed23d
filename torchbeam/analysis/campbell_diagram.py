"""Campbell diagram: what `campbell` returns; critical speeds, unstable ranges, a picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from ..core.arguments import count, listed
from ..core.summary import counted, kind, lines, span
from ..core.validation import concrete
from ..linear.elsewhere import array_of, write
from ..linear.whirl import grows
from ..math.quadratic_eigen import relaxes
from ..plot.canvas import Axes
from ..plot.curves import SPEED_UNITS, legend_above
from ..plot.curves import campbell as frequencies_over_speed

SHADE = dict(color="C3", alpha=0.15, lw=0)  # of unstable ranges in a picture


class Critical(NamedTuple):
    """A speed (rad/s) at which a multiple of it, `order`, is the frequency of a mode."""

    speed: float
    order: int
    mode: str


@dataclass(frozen=True)
class Campbell:
    """Modes of a spinning rotor over its speed, each mode in one column at all speeds.

    Args:
        speed: (n,) rad/s
        eigenvalue: (n, ..., count) complex, 1/s; a positive real part grows
        shape: (n, ..., count, nodes, 6) complex: displacement (m) and rotation (rad) of the nodes,
            frame a, at the azimuth 0; of the rotor in coordinates that do not spin
        whirl: (n, ..., count) mean harmonic of the rotor's motion, seen from the ground: 1 for a
            forward whirl, -1 for a backward one, 0 for a motion of all blades alike or in a plane
        names: of the modes, by what moves most at the highest speed; of a batch its first
            sample's
        error: (n, ..., count) 1/s, of the eigenvalue by the steps of "floquet"; 0 of "multiblade"
        method: "multiblade" or "floquet"
        growth: (n, ...) 1/s, of the motion that grows fastest, those beyond `count` too; 0 where
            none does
        ranges: `unstable_ranges`; None of a batch

    Examples:
        >>> disc = tb.Body(mass=2.0, inertia=(0.02, 0.01, 0.01), position=(1.0, 0, 0))
        >>> shaft = tb.Beam.straight(1.0, 2, tb.Section.circle(0.01, 210e9, 0.3, 7800.0))
        >>> scene = tb.Scene(
        ...     {"shaft": shaft, "disc": disc},
        ...     joints=[tb.Hinge(("shaft", -1), "disc", axis=(1, 0, 0))],
        ...     supports=[tb.Support(("shaft", 0))],
        ... )
        >>> diagram = tb.campbell(scene, torch.linspace(0, 300, 4), count=4)
        >>> [round(c.speed) for c in diagram.critical(orders=1)]  # rad/s
        [44, 45, 252]
        >>> diagram.unstable_ranges
        []
    """

    speed: Tensor
    eigenvalue: Tensor
    shape: Tensor
    whirl: Tensor
    names: list[str]
    error: Tensor
    method: str
    growth: Tensor
    ranges: tuple[tuple[float, float], ...] | None

    def __repr__(self) -> str:
        return lines(
            "Campbell",
            f"{counted(len(self.names), 'mode')} at {counted(len(self.speed), 'speed')} "
            f"{span(self.speed)} rad/s, {self.method}",
            *(
                f"{name}: {span(self.frequency[..., k])} rad/s, "
                f"damping {span(self.damping[..., k].round(decimals=9))}"
                for k, name in enumerate(self.names)
            ),
            *(f"unstable from {a:.4g} to {b:.4g} rad/s" for a, b in self.ranges or ()),
            kind(self.eigenvalue.shape[1:-1], self.speed),
        )

    @property
    def frequency(self) -> Tensor:
        """(n, ..., count) rad/s."""
        return self.eigenvalue.imag.abs()

    @property
    def damping(self) -> Tensor:
        """(n, ..., count) damping ratio, -real part / |eigenvalue|; below 0 for growth."""
        size = self.eigenvalue.abs()
        return -self.eigenvalue.real / torch.where(size == 0, 1, size)

    @property
    def unstable(self) -> Tensor:
        """(n, ..., count) bool: grows, beyond rounding and the error of the steps."""
        speed = self.speed.reshape(-1, *(1,) * (self.eigenvalue.ndim - 1))
        return grows(self.eigenvalue, speed, self.error)

    @property
    def unstable_ranges(self) -> list[tuple[float, float]]:
        """From which speed to which (rad/s) a motion grows, one beyond `count` too. Ends between
        speeds are searched, within 1e-6 of the speed, of "floquet" 1e-3; of periodic orbits by a
        straight line. A range between two neighbours of `speed` is not seen.

        Raises ValueError for a batch.
        """
        self._one("unstable_ranges")
        return list(self.ranges or ())

    def critical(self, orders: Sequence[int] | int = (1, 2, 3)) -> list[Critical]:
        """Speeds at which a multiple of the speed meets a frequency, rising; between the given
        speeds by a straight line. Unbalance excites forward whirls at order 1.

        Raises ValueError for a batch, of which `critical_speed` tells, or orders that are no whole
        numbers from 1 on.
        """
        self._one("critical")
        x, y = concrete(self.speed).detach(), concrete(self.frequency).detach()
        crossings = []
        for order in listed(orders):
            gap = y - count("an order", order) * x[:, None]
            crossed = ((gap[:-1] > 0) != (gap[1:] > 0)) & self._swings
            for i, k in crossed.nonzero().tolist():
                share = (gap[i, k] / (gap[i, k] - gap[i + 1, k])).item()
                at = x[i].item() + share * (x[i + 1] - x[i]).item()
                crossings.append(Critical(at, order, self.names[k]))
        return sorted(crossings)

    def critical_speed(self, order: int = 1) -> Tensor:
        """(..., count) rad/s: the lowest speed of which a multiple meets the frequency of each
        mode, of each sample; NaN where none does. As `critical`, with derivatives.
        """
        x = self.speed.reshape(-1, *(1,) * (self.frequency.ndim - 1))
        gap = self.frequency - count("order", order) * x
        crossed = ((gap[:-1] > 0) != (gap[1:] > 0)) & self._swings
        at = crossed.to(torch.int8).argmax(0, keepdim=True)
        low, high = gap[:-1].gather(0, at)[0], gap[1:].gather(0, at)[0]
        there = crossed.any(0)
        share = torch.where(there, low, 0) / torch.where(there, low - high, 1)
        return torch.where(there, (self.speed[at] + share * self.speed.diff()[at])[0], torch.nan)

    def plot(
        self,
        ax: Axes | None = None,
        *,
        orders: Sequence[int] = (1, 2, 3),
        damping: Axes | None = None,
        unit: str = "rad/s",
    ) -> Axes:
        """Frequencies over speed, with rays at multiples of the speed and unstable ranges shaded;
        in the axes `damping` the damping ratios, in the same colours. Motions that relax at all
        speeds are left out. unit="rpm": speeds in rpm, frequencies in Hz.

        Raises ValueError for a batch, ImportError without matplotlib.
        """
        self._one("plot")
        swings = self._swings if self._swings.any() else torch.ones_like(self._swings)
        names = [name for name, there in zip(self.names, swings, strict=True) if there]
        speed, frequency = self.speed.detach(), concrete(self.frequency.detach())[:, swings]
        look = dict(orders=orders, names=names, unit=unit)
        ax = frequencies_over_speed(speed, frequency, ax, **look)
        size = SPEED_UNITS[unit][0]
        if damping is not None:
            for k, ratio in enumerate(self.damping.detach().T[swings]):
                damping.plot(size * speed, ratio, color=f"C{k % 10}", lw=1.6)
            damping.axhline(0.0, color="0.6", lw=0.8)
            damping.set(xlabel=ax.get_xlabel(), ylabel="damping ratio", xlim=ax.get_xlim())
        for k, (low, high) in enumerate(self.ranges or ()):
            for axes in filter(None, (ax, damping)):
                axes.axvspan(size * low, size * high, label=None if k else "unstable", **SHADE)
        return legend_above(ax)

    def save(self, path: str | Path) -> Path:
        """Write speed, frequency, damping, eigenvalue, whirl, error, growth and names into a file
        .npz or .mat, whole or not at all. Raises as `Linear.save`.
        """
        value = self.eigenvalue
        parts = dict(speed=self.speed, frequency=self.frequency, damping=self.damping)
        parts |= dict(real=value.real, imag=value.imag, whirl=self.whirl, error=self.error)
        parts["growth"] = self.growth
        return write(path, {k: array_of(k, v) for k, v in parts.items()}, {"names": self.names})

    def _one(self, what: str) -> None:
        if self.ranges is None:
            raise ValueError(
                f"{what} of a diagram with the batch axes {tuple(self.eigenvalue.shape[1:-1])} was "
                "asked for; one without is wanted"
            )

    @property
    def _swings(self) -> Tensor:
        """(..., count) bool: which modes do not relax at all speeds, those of a picture."""
        value, whirl = (concrete(x).detach() for x in (self.eigenvalue, self.whirl))
        speed = concrete(self.speed).reshape(-1, *(1,) * (value.ndim - 1))
        turning = value - 1j * speed * whirl.round()
        return ~(relaxes(value) | relaxes(turning)).all(0)
