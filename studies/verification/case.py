"""Case: one known number or series, its source, and its computation here."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import torch
from torch import Tensor

from ..harness import data, double_precision

Solve = Callable[[], tuple[Tensor, Tensor]]
ORDER = "elements are of second order: the measured error of this mesh and a tenth"


@dataclass(frozen=True)
class Case:
    """One row of the table.

    source    where the reference is from;  quantity: what is compared;  mesh: elements, step
    solve     () -> (ours, reference), tensors of one shape
    bound     on the error; why: where that bound is from
    scale     what differences are divided by; None = each entry by its reference
    coarse    the same on half as many elements, whose error is four times as large
    """

    name: str
    source: str
    quantity: str
    mesh: str
    solve: Solve
    bound: float
    why: str = ORDER
    scale: float | None = None
    coarse: Solve | None = None


@dataclass(frozen=True)
class Result:
    """reference and ours: the entry of the largest error; entries: of how many."""

    case: str
    source: str
    quantity: str
    reference: float
    ours: float
    error: float
    bound: float
    entries: int
    mesh: str
    seconds: float
    why: str

    @property
    def ok(self) -> bool:
        return self.error <= self.bound


def run(case: Case) -> Result:
    """Solve it in float64; an equilibrium that is unstable is meant where one is looked for."""
    begin = time.perf_counter()
    with double_precision(), warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore", RuntimeWarning)
        ours, reference = (
            x.detach().double().flatten() for x in torch.broadcast_tensors(*case.solve())
        )
    seconds = time.perf_counter() - begin
    error = (ours - reference).abs() / (reference.abs() if case.scale is None else case.scale)
    error = torch.where(torch.isfinite(error), error, torch.inf)
    at = int(error.argmax())
    numbers = (x[at].item() for x in (reference, ours, error))
    told = case.bound, error.numel(), case.mesh, seconds, case.why
    return Result(case.name, case.source, case.quantity, *numbers, *told)


reference = cache(data)  # the contents of data/NAME.json


def columns(values: list[dict[str, float]], *names: str) -> tuple[Tensor, ...]:
    """The named numbers of a list of records, each (len,)."""
    return tuple(torch.tensor([v[name] for v in values]) for name in names)
