"""Filtered: what is known of a structure after some readings, how well, and whether to doubt it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ...core.arguments import choice, instance, quantile
from ...core.status import STATUS, SUCCESS
from ...core.summary import kind, lines
from ...core.validation import refusal
from ...math.square_root import Conditioned
from ...sensors.sensor import Sensor
from ...state.state import State
from .interval import Moved
from .weighting import LEFT_OUT, Beyond

MEMORY = 50  # intervals over which the readings' errors are judged
DOUBT = 5.0  # deviations of their sum of squares, from which on the model is doubted


@dataclass(frozen=True, eq=False)
class Filtered:
    """The estimate of a `KalmanFilter` or a `MovingHorizon` at one instant.

    Attributes:
        state: of the structure
        x: (..., size) z, then the other unknowns (`unknowns.names`; parameters by their
            coordinates), then delayed readings
        factor: (..., size, size): factor^T factor is the covariance of x
        nis: (...) normalised innovation squared: the squares of the last readings' errors, in units
            of their expected deviations. The mean is `readings` if the model is right
        readings: (...) number of readings that count
        weight: (..., m) how much each of the last readings counts: 1 fully, 0 if it is missing or
            left out by the gate
        log_likelihood: (...) of all readings, with a loss by its density (Laplace's approximation):
            compares models and delays

    Examples:
        >>> pushed = tb.Scene(beam, [tb.TipLoad(force=tb.Input("push", 3)), tb.Damping(0.01)])
        >>> tip = tb.sensors.TipPosition()["z"]
        >>> f = tb.KalmanFilter(pushed, tip, dt=0.02, noise=1e-3, process={"push": (0, 0, 0.1)})
        >>> z = f(f.start(amplitude=0.01), [0.002])
        >>> z.reading(tip)[1] < 1e-3  # m, its deviation
        tensor([True])
    """

    filter: Any
    state: State
    x: Tensor
    factor: Tensor
    nis: Tensor
    readings: Tensor
    weight: Tensor
    log_likelihood: Tensor
    lately: Tensor  # (..., 3): of the readings' errors, sum of squares, its mean, its variance
    missed: Tensor  # (..., m): of each reading, how many in a row were beyond the gate
    # of the last interval: readings and x' by x, and what the readings said
    learnt: tuple[Tensor, Conditioned] | None = None
    about: Tensor | None = None  # (..., p): parameters' coordinates at which the structure stands
    window: Any = None  # of a `MovingHorizon`

    def of(self, size: int) -> Filtered:
        """Itself. Raises ValueError for another size than a filter has."""
        if self.x.shape[-1] != size:
            numbers = self.x.shape[-1]
            raise refusal(f"an estimate of {numbers} numbers", f"one of the {size} of this filter")
        return self

    def __repr__(self) -> str:
        names = ", ".join(self.filter.unknowns.names) or "none"
        said = filter(None, [self.doubt])
        return lines("Filtered", f"unknowns: {names}", kind(self.x.shape[:-1], self.x), *said)

    @property
    def covariance(self) -> Tensor:
        """(..., size, size) of x."""
        return self.factor.mT @ self.factor

    @property
    def unknown(self) -> dict[str, Tensor]:
        """Name -> (...): the estimate of each parameter, offset and force."""
        own, x = self.filter.unknowns, self._own(self.x)
        theta = (
            x if own.parameters is None else torch.cat((own.theta(x), x[..., own.of_model :]), -1)
        )
        return dict(zip(own.names, theta.unbind(-1), strict=True))

    def interval(self, name: str, level: float = 0.95) -> Tensor:
        """(..., 2) ends of the interval that holds the unknown of this name with probability
        `level`, by its coordinate.
        """
        own = self.filter.unknowns
        i = own.names.index(choice("name", name, own.names))
        reach = quantile("level", level)
        x, deviation = self._own(self.x), self._own(self.factor.norm(dim=-2))
        ends = torch.stack([x + side * reach * deviation for side in (-1, 1)], -2)
        return own.theta(ends)[..., i] if i < own.of_model else ends[..., i]

    def reading(self, sensor: Sensor) -> tuple[Tensor, Tensor]:
        """Reading (..., r) of a sensor, and its deviation. The sensor may read places, turns,
        speeds and strains.
        """
        instance("sensor", sensor, Sensor)
        y, by_z = self.filter.interval.slope_of(sensor.flat, self.state)
        n = by_z.shape[-1]
        return y, (self.factor[..., :n] @ by_z.mT).norm(dim=-2)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Names of unknowns that the readings do not determine, in any sample."""
        return self.filter.unknowns.unseen(self._own(self.factor.norm(dim=-2)))

    @property
    def doubt(self) -> str | None:
        """A sentence with a reason to doubt the estimate, or None."""
        failed = self.state.status != SUCCESS
        if failed.any():
            code = int(self.state.status[failed].flatten()[0])
            return (
                f"{int(failed.sum())} of {failed.numel()} samples stand still, their step has "
                f"failed ({STATUS[code]}); a smaller step, or smaller first deviations, are wanted"
            )
        squares, mean, variance = self.lately.unbind(-1)
        away = (squares - mean) / variance.clamp(min=1e-300).sqrt()
        if (away > DOUBT).any():
            worst = away.flatten().argmax()
            ratio = (squares / mean).flatten()[worst].sqrt()
            return (
                f"readings of {int((away > DOUBT).sum())} of {away.numel()} samples lie up to "
                f"{ratio.item():.1f} times as far from what was expected as noise, process and "
                "unknowns explain; another model, or larger ones of these, are wanted"
            )
        return None

    def judged(self, beyond: Beyond) -> Filtered:
        """With the last readings' errors among those of lately, and what was left out. With a loss
        a single fault is no doubt either.
        """
        keep, read, nis = 1 - 1 / MEMORY, self.readings + beyond.count, self.nis
        if self.filter.weighting.loss is not None:
            nis = nis.minimum(LEFT_OUT**2 * self.readings)
        now = torch.stack((nis + beyond.squares, read, 2 * read), -1)
        return replace(
            self, lately=self.lately * self.lately.new_tensor([keep, keep, keep**2]) + now
        )

    def _own(self, x: Tensor) -> Tensor:
        """Of x (..., size) what stands beside z."""
        n = self.filter.moves
        return x[..., n : n + len(self.filter.unknowns.names)]


class Predicted(NamedTuple):
    """What is expected of an interval's end, before it is read: what was known at its begin, under
    which inputs (..., inputs) it goes on; about, after, readings, x, columns  as `_moved` has them;
    more (..., n)  what z is beyond that state;  rows  further sources of readings and x.
    """

    before: Filtered
    inputs: Tensor
    about: Tensor | None = None
    after: Moved | None = None
    readings: Tensor | None = None
    x: Tensor | None = None
    columns: Tensor | None = None
    more: Tensor | None = None
    rows: Tensor | None = None
