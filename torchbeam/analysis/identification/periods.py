"""Periods: whether a fit swings at the frequency at which the data do.

Squares of the misfit of what swings have a minimum for about each period by which a model is off
over the record, so that a search from afar ends beside the right one. There the largest line of the
data, which a model near to them explains, is left as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from .hints import ALARM, series
from .problem import FitProblem
from .residuals import FEWEST
from .spectrum import Spectrum

SHARE = 0.25  # of a channel's squares, that its largest line has at least
LEFT = 0.5  # of the squares of that line, which a fit leaves
TURNS = 2.0  # in a record: what swings less often has no period to be off by
GAP = 0.1  # of a record, without readings: each side has its own level and trend
CHANGE = 1e-3  # of a parameter's logarithm, for the power
TRIED = 9  # starts, from half to twice of what the power says
POWER = 0.05  # of a parameter, with which a frequency goes at least
FARTHEST = 30.0  # factor by which a start may be off


@dataclass(frozen=True)
class Swing:
    """A channel's largest line.

    name, rows (n,)  of its readings among the data;  spectrum, level (n, q)  of its times, and what
                     goes off as levels and trends;  values (n,)
    place, frequency (Hz), squares  of the line;  share  of all the channel's squares
    """

    name: str
    rows: Tensor
    spectrum: Spectrum
    level: Tensor
    values: Tensor
    place: int = 0
    frequency: float = 0.0
    squares: float = 0.0
    share: float = 0.0

    @classmethod
    def of(cls, name: str, rows: Tensor, times: Tensor, values: Tensor) -> Swing:
        """Of values (n,) at times (n,) in order."""
        return cls(name, rows, Spectrum.of(times, values), _levels(times), values).like(values)

    def like(self, values: Tensor) -> Swing:
        """That of other values (n,) of the channel."""
        rest = self.rest(values)
        power = self.spectrum.power(rest)
        k = int(power.argmax())
        squares = power[k].item()
        share = squares / max(rest.square().sum().item(), torch.finfo(values.dtype).tiny)
        f = self.spectrum.at(power, k)
        return replace(self, values=values, place=k, frequency=f, squares=squares, share=share)

    def left(self, values: Tensor) -> float:
        """Squares that a line of this frequency takes from values (n,)."""
        return self.spectrum.power(self.rest(values))[self.place].item()

    def rest(self, values: Tensor) -> Tensor:
        """Values (n,) without levels and trends."""
        return values - self.level @ (self.level.mT @ values)

    def frequency_power(self, by: Tensor) -> float:
        """d ln(frequency) as the values change by `by` (n,)."""
        up, down = (self.like(self.values + s * CHANGE * by).frequency for s in (1, -1))
        return math.log(up / down) / (2 * CHANGE)

    @property
    def clear(self) -> bool:
        """Whether independent noise, and what goes by less than some turns, has no such line."""
        turns = self.frequency * self.spectrum.duration
        return self.share > SHARE and turns >= TURNS and self._stands_out(self.share)

    def beyond_noise(self, white: Tensor) -> bool:
        """Whether noise that remembers has no such line, by readings (n,) without its memory."""
        rest = self.rest(white).square().sum().item()
        return self._stands_out(self.left(white) / max(rest, torch.finfo(white.dtype).tiny))

    def _stands_out(self, share: float) -> bool:
        """Of a share of squares that independent noise hardly ever has in one of its lines."""
        n = self.rows.numel() - self.level.shape[1]
        chance = math.log(n / 2) + (n / 2 - 1) * math.log1p(-min(share, 1 - 1e-12))
        return chance < math.log(ALARM)


def period_hints(problem: FitProblem, r: Tensor, J: Tensor, k: int, x: Tensor) -> tuple[str, ...]:
    """A sentence of each experiment whose channel that swings most does so where the fit does not;
    with the parameter by which the fit's own frequency goes most, where that would be the data's.

    r (T,), J (T, p) weighted, k and x (p,) number of the start and coordinates where it ended
    """
    if not (torch.isfinite(r).all() and torch.isfinite(J).all()):
        return ()
    target = problem.target[min(k, len(problem.target) - 1)]
    data, model = (problem.white.inverse(v) for v in (target, target + r))
    weight, most = problem.white.weight, {}
    for experiment, name, rows, times in series(problem):
        if times is None or len(rows) < FEWEST or not times[-1] > times[0]:
            continue
        swing = Swing.of(name, rows, times, data[rows] * weight[rows].mean())
        if experiment not in most or swing.squares > most[experiment].squares:
            most[experiment] = swing
    said = []
    for swing in most.values():
        rows, scale = swing.rows, weight[swing.rows].mean()
        left = swing.left((model - data)[rows] * scale)
        left /= max(swing.squares, torch.finfo(r.dtype).tiny)
        if swing.clear and swing.beyond_noise(target[rows]) and left > LEFT:
            by = problem.white.inverse(J.mT)[:, rows]
            said.append(_sentence(problem, swing, (data[rows], model[rows], by), left, x))
    return tuple(said)


def _sentence(
    problem: FitProblem, swing: Swing, there: tuple[Tensor, Tensor, Tensor], left: float, x: Tensor
) -> str:
    """Of data (n,), a fit (n,) and its derivatives (p, n) by coordinates x (p,), which leaves that
    of a line.
    """
    data, model, by = there
    own = swing.like(model)
    what = repr(swing.name) if swing.name else "what was measured"
    text = (
        f"{what} swings most at {swing.frequency:.3g} Hz, and of that line the fit leaves "
        f"{100 * left:.0f} %; "
    )
    if not own.clear:
        return (
            f"{text}the model hardly swings there: it misses what does, or another start, or "
            "several (`starts`), are wanted"
        )
    text += (
        f"the model swings at {own.frequency:.3g} Hz: the search seems to have ended some periods "
        "off, or the model misses what swings so; "
    )
    if (start := _start(problem, swing, own, data, by, x)) is None:
        return f"{text}another start, or several (`starts`), are wanted"
    return (
        f"{text}a start of {start[0]} at about {start[1]:.3g} is wanted, where it swings as they do"
    )


def _start(
    problem: FitProblem, swing: Swing, own: Swing, data: Tensor, by: Tensor, x: Tensor
) -> tuple[str, float] | None:
    """Of the parameter by whose factor the model's frequency goes most, name and the value at which
    the model swings as the data do: where its power there says, and of a batch about that the one
    that is nearest to the data, of those with their frequency.
    """
    p, T = problem.parameters, problem.parameters.transform
    theta, slope = T.theta(x[None]), T.slope(x)
    size = theta[0].abs() / slope.abs()  # change of a coordinate for a factor e
    power = [
        own.frequency_power(size[j] * by[j]) if 0 < size[j] < torch.inf else 0.0
        for j in range(p.model)
    ]
    best = max(range(p.model), key=lambda j: abs(power[j]))
    if abs(power[best]) < POWER:
        return None
    factor = math.log(swing.frequency / own.frequency) / power[best]
    if abs(factor) > math.log(FARTHEST):
        return None
    factors = (factor + torch.linspace(-1.0, 1.0, TRIED).to(x) * math.log(2.0)).exp()
    rows = theta.repeat(TRIED, 1)
    rows[:, best] *= factors
    rows = rows.clamp(*p.limits)
    try:
        y = problem.values(rows)[:, problem.known][:, swing.rows]
    except Exception:  # a model that raises there, as at a trial of the search
        return None
    # of a frequency: what a record tells, or half from one try to the next
    step = 2 * math.log(2.0) / (TRIED - 1) * abs(power[best])
    near = max(0.5 / (swing.frequency * swing.spectrum.duration), 0.6 * step)
    best_left, value = math.inf, None
    for k, v in enumerate(y):
        if not torch.isfinite(v).all():
            continue
        if abs(math.log(own.like(v).frequency / swing.frequency)) > near:
            continue
        if (left := swing.rest(data - v).square().sum().item()) < best_left:
            best_left, value = left, rows[k, best].item()
    return None if value is None else (p.names[best], value)


def _levels(times: Tensor) -> Tensor:
    """Orthonormal columns (n, q) of a level and a trend on each side of gaps."""
    far = times.diff() > GAP * (times[-1] - times[0])
    part = torch.nn.functional.pad(far.cumsum(0), (1, 0))
    on = torch.nn.functional.one_hot(part).to(times)
    middle = (on * times[:, None]).sum(0) / on.sum(0)
    columns = torch.cat((on, on * (times[:, None] - middle)), -1)
    size = torch.linalg.vector_norm(columns, dim=0)
    columns = columns[:, size > 1e-9 * size.max()]
    return columns / torch.linalg.vector_norm(columns, dim=0)
