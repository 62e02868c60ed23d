"""Design: sensors and runs that were chosen, and what they will tell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from ...core.summary import aligned
from .information import Information
from .measurement import Measurement
from .report import write_design
from .selection import Criterion, Selection


@dataclass(frozen=True, eq=False)
class Design:
    """Result of `tb.design`.

    Args:
        sensors: names of the chosen candidates, the most informative first, repeated if chosen
            again
        measurements: name -> measurements of the candidate; `dataclasses.replace` adds the values
            later
        runs: input -> how often it is run
        criterion: "D", "A" or "c"
        value: (sensors,) criterion after each sensor, infinite until `of` is determined
        bound: lower bound of any choice of the same number, or cost, with these runs
        whole: criterion of all candidates together
        names, deviation: (p,) of the parameters, and the deviations that a fit to such data will
            have; infinite for undetermined parameters. Over several draws, the RMS
        theta: (draws, p) points of the derivatives
        change: candidate -> factor of the criterion without it if it was chosen, or with it if not
        cost: of all chosen candidates
        hints: sentences about undetermined parameters

    Examples:
        >>> model = lambda p: (p["F"][:, None] * torch.tensor([1.0, 4.0, 9.0])).unbind(-1)
        >>> places = {f"place {k}": tb.Measurement(torch.nan, 0.1) for k in range(3)}
        >>> plan = tb.design(model, places, {"F": 2.0}, sensors=1)
        >>> plan.sensors, plan.deviation  # 0.1 / 9
        (('place 2',), tensor([0.0111]))
    """

    sensors: tuple[str, ...]
    measurements: dict[str, list[Measurement]]
    runs: dict[str, int]
    criterion: str
    value: Tensor
    bound: float
    whole: float
    names: tuple[str, ...]
    deviation: Tensor
    theta: Tensor
    change: dict[str, float]
    cost: float
    hints: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        known: Information,
        selection: Selection,
        chosen: Sequence[int],
        present: Sequence[int],
        groups: Mapping[str, list[Measurement]],
        runs: dict[str, int],
        unit: Tensor,
    ) -> Design:
        """Design of chosen candidates of a selection, whose coordinates are over `unit` (p,)."""
        rule, items, every = selection.criterion, selection.items, [*groups]
        order = selection.in_order(chosen)
        M = selection.information(order)
        sums = [selection.information(order[: k + 1]) for k in range(len(order))]
        value = rule.deviation(torch.stack(sums))
        without = [k in order or k in present for k in range(len(every))]
        sign = torch.tensor(without).to(items)[:, None, None, None]
        change = rule.deviation(M + items * (1 - 2 * sign)) / value[-1]
        parameters, m = known.problem.parameters, known.problem.parameters.model
        slope = parameters.transform.slope(known.x)[:, :m]
        own = Criterion("A", torch.diag_embed(slope) / unit)
        deviation = own.spread(M).diagonal(dim1=-2, dim2=-1).mean(0).sqrt()
        deviation = torch.where(own.open(M), torch.inf, deviation)
        names = parameters.names[:m]
        open_ = [n for n, d in zip(names, deviation.tolist(), strict=True) if d == torch.inf]
        hints = [f"these sensors do not tell {', '.join(open_)}"] * bool(open_)
        bound = min(math.exp(selection.bound(order)), value[-1].item())
        all_items = items.sum(0) - items[list(present)].sum(0)
        # fmt: off
        return cls(sensors=tuple(every[k] for k in order),
                   measurements={every[k]: groups[every[k]] for k in [*present, *order]},
                   runs=runs, criterion=rule.kind, value=value, bound=bound,
                   whole=rule.deviation(selection.base + all_items).item(), names=names,
                   deviation=deviation, theta=parameters.transform.theta(known.x)[:, :m],
                   change=dict(zip(every, change.tolist(), strict=True)),
                   cost=selection.cost[order].sum().item(), hints=tuple(hints))
        # fmt: on

    @property
    def efficiency(self) -> float:
        """Information over that of all candidates together: the squared ratio of the criterion's
        values.
        """
        return (self.whole / self.value[-1].item()) ** 2

    @property
    def optimality(self) -> float:
        """Information over the most that any choice of as many may have, at least."""
        return (self.bound / self.value[-1].item()) ** 2

    def tables(self) -> list[list[tuple[str, ...]]]:
        """Rows of sensors, of runs and of parameters, each with its head."""
        values = zip(self.sensors, self.value.tolist(), strict=True)
        sensors = [(n, f"{v:.4g}", f"{self.change[n]:.3g}") for n, v in values]
        runs = [(n, f"{times}") for n, times in self.runs.items() if times]
        theta = zip(self.names, self.theta.mean(0).tolist(), self.deviation.tolist(), strict=True)
        return [
            [("sensor", f"{self.criterion} with those above", "times, without it"), *sensors],
            [("run", "times"), *runs],
            [
                ("parameter", "value", "deviation"),
                *((n, f"{v:.5g}", f"{d:.2g}") for n, v, d in theta),
            ],
        ]

    def said(self) -> list[str]:
        """Sentences about the result."""
        return [
            f"{100 * self.efficiency:.3g} % of the information of all {len(self.change)} "
            f"candidates; at least {100 * self.optimality:.3g} % of the best choice's; cost "
            f"{self.cost:g}",
            *self.hints,
        ]

    def summary(self) -> str:
        """Tables of sensors, runs and parameters, and sentences."""
        parts = ["\n".join(aligned(rows, right=(1, 2))) for rows in self.tables()]
        return "\n\n".join([*parts, "\n".join(self.said())])

    def report(self, path: str | Path) -> Path:
        """Write a page of HTML, with the picture of `tb.plot.design`. It needs matplotlib. Raises
        files.NotWritten (an OSError).
        """
        return write_design(self, path)

    def __repr__(self) -> str:
        runs = ", ".join(f"{times} x {name!r}" for name, times in self.runs.items() if times)
        return (
            f"Design({', '.join(self.sensors)}; runs {runs}; {self.criterion} "
            f"{self.value[-1].item():.4g}, {100 * self.efficiency:.3g} % of all)"
        )
