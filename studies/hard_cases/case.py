"""Case: a problem, its solution and its check, run in float64, float32, as a batch and with its
gradient.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import torch
from torch import Tensor

from torchbeam import SlowPathWarning

VARIANTS = ("float64", "float32", "batch", "gradient")
BATCH = 64, 8  # samples of the batch, in full and reduced
SPREAD = 0.01  # of p over the batch
# of the largest value: rounding, which hundreds of steps magnify, of products of another shape
IN_BATCH = 1e-10
NUDGE = 1e-5  # of p, for central differences
FROM = {"float32": "float64", "batch": "the sample alone", "gradient": "central differences"}
WEIGHTS = (1.0, 0.7, -0.4)  # of the value's last axis in the scalar whose gradient is taken


class Answer(NamedTuple):
    """Of B samples: status (B,) 0 = success; value (B, ..., 3), differentiable; error (B,) what the
    case checks; iterations a step (mean over steps and samples), None in statics; `why` it failed,
    where the solver said.
    """

    status: Tensor
    value: Tensor
    error: Tensor
    iterations: float | None = None
    why: str = ""


@dataclass(frozen=True)
class Case:
    """One row of the list.

    hard      what makes it hard;  check: what `error` is
    solve     (p, size) -> `Answer`; p (B,) near 1 scales a load, its dtype is the case's
    bound     on error; in float32 the larger of it and `single`
    single    on the distance of float32's value from float64's, over the largest value
              (at least 0.1 m)
    gradient  relative tolerance of the gradient by p against central differences
    size      steps (or turns) in full, and reduced (for tests)
    long      steps that only --long runs, without batch and gradient
    fails     variant -> why: what is known to fail. Strict: it has to;  later: at the full size
              alone;  last: at `long`
    """

    name: str
    hard: str
    check: str
    solve: Callable[[Tensor, int], Answer]
    bound: float = 1e-2
    single: float = 1e-3
    gradient: float = 1e-5
    size: tuple[int, int] = (1, 1)
    long: int | None = None
    fails: dict[str, str] = field(default_factory=dict)
    later: dict[str, str] = field(default_factory=dict)
    last: dict[str, str] = field(default_factory=dict)


@dataclass
class Result:
    """Result of one variant of a case. difference: float32's, the batch's and the gradient's own
    check; reason: why not ok; known: why it was expected to fail.
    """

    case: str
    variant: str
    ok: bool
    status: int
    error: float
    difference: float | None
    iterations: float | None
    seconds: float
    reason: str = ""
    known: str = ""

    @property
    def expected(self) -> bool:
        """Whether it went as the list says: strict both ways."""
        return self.ok == (not self.known)


def run(case: Case, quick: bool = False, long: bool = False) -> list[Result]:
    """Every variant of a case; `quick`: at the reduced size of the tests; `long`: at its largest,
    in both precisions alone.
    """
    long = long and case.long is not None
    size = case.long if long else case.size[quick]
    known = {**case.fails, **(case.last if long else {} if quick else case.later)}
    results, alone = [], None
    for variant in VARIANTS[:2] if long else VARIANTS:
        begin = time.perf_counter()
        p = _parameter(variant, BATCH[quick])
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # a failure is told by its status
                # of nearly impossible strains it is made eagerly, and that it is right is the check
                if variant == "gradient":
                    warnings.simplefilter("ignore", SlowPathWarning)
                answer = case.solve(p, size)
                difference, allowed = _own_check(variant, case, p, answer, alone)
        except (RuntimeError, ValueError) as error:
            why, spent = f"raises {type(error).__name__}: {error}", time.perf_counter() - begin
            failed = Result(case.name, variant, False, -1, torch.nan, None, None, spent, why)
            results.append(failed)
            continue
        alone = answer.value.detach() if alone is None else alone
        spent = time.perf_counter() - begin
        results.append(_judge(case, variant, answer, difference, allowed, spent))
    return [replace(r, known=known.get(r.variant, "")) for r in results]


def _parameter(variant: str, batch: int) -> Tensor:
    one = torch.ones(1, dtype=torch.float32 if variant == "float32" else torch.float64)
    if variant == "batch":
        return one + SPREAD * torch.linspace(0, 1, batch, dtype=one.dtype)
    if variant == "gradient":
        return (one + NUDGE * one.new_tensor([0.0, 1, -1])).requires_grad_()
    return one


def _own_check(
    variant: str, case: Case, p: Tensor, answer: Answer, alone: Tensor | None
) -> tuple[float | None, float]:
    """(what the variant adds to the case's check, its bound)."""
    if alone is None:
        return None, 0.0
    if variant == "gradient":
        scalar = (answer.value * answer.value.new_tensor(WEIGHTS)).flatten(1).sum(-1)
        (slope,) = torch.autograd.grad(scalar.sum(), p)
        wanted = (scalar[1] - scalar[2]).detach() / (2 * NUDGE)
        size = torch.maximum(wanted.abs(), scalar[0].detach().abs().clamp(min=1e-12) * 1e-3)
        return ((slope[0] - wanted).abs() / size).item() if torch.isfinite(
            slope
        ).all() else torch.nan, case.gradient
    gap = (answer.value.detach()[0].to(alone) - alone[0]).abs().max() / alone.abs().max().clamp(
        min=0.1
    )
    return gap.item(), case.single if variant == "float32" else IN_BATCH


def _judge(
    case: Case,
    variant: str,
    answer: Answer,
    difference: float | None,
    allowed: float,
    seconds: float,
) -> Result:
    error = answer.error.detach().max().item()
    status = int(answer.status.max())
    reasons = []
    if status != 0:
        count = int((answer.status != 0).sum())
        reasons.append(
            f"status {status} in {count} of {answer.status.numel()}"
            + (f": {answer.why}" if answer.why else "")
        )
    if not torch.isfinite(answer.value).all():
        reasons.append("the value is not finite")
    bound = max(case.bound, case.single) if variant == "float32" else case.bound
    if not error <= bound:
        reasons.append(f"{case.check}: {error:.1e} where {bound:.0e} is accepted")
    if difference is not None and not difference <= allowed:
        what = FROM[variant]
        reasons.append(f"{difference:.1e} from {what} where {allowed:.0e} is accepted")
    numbers = status, error, difference, answer.iterations, seconds
    return Result(case.name, variant, not reasons, *numbers, "; ".join(reasons))
