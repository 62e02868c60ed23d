"""Instants of runs: in double precision, whatever a scene is computed in, and told apart by enough
digits for the steps between them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from ..core.validation import concrete, is_vmapped
from .step_inputs import in_line

SHARE = 0.1  # of a step: what rounding may move its ends by
# s, what rounding has taken off the instants that steps have made, as long as those live
_lost = WeakTensorKeyDictionary()


def exact(t: Tensor, latest: Tensor | None = None) -> Tensor:
    """Instants t (...) s of a state in double precision: as steps have counted them that made this
    tensor or `latest`, where it has the same numbers (of a state that was detached, say).
    """
    if t.dtype == torch.float64 or is_vmapped(t):
        return t
    now, lost = t.double(), _lost.get(t)
    if lost is None and latest is not None and latest.shape == t.shape:
        lost = _lost.get(latest)
        lost = None if lost is None else torch.where(t == latest, lost, 0.0)
    if lost is None:
        return now
    counted = now + lost
    return torch.where(counted.to(t.dtype) == t, counted, now)  # else it was written to


def rounded(instants: Tensor, dtype: torch.dtype) -> Tensor:
    """Instants (...) s in the dtype of states, of which `exact` knows the digits that are lost."""
    t = instants.to(dtype)
    if t is not instants and not is_vmapped(t):
        _lost[t] = (instants - t).detach()
    return t


def largest(x: Tensor) -> float:
    """The largest size in x, 0 of no numbers."""
    return concrete(x).detach().abs().amax().item() if x.numel() else 0.0


def check_digits(step: float, latest: float | Tensor, dtype: torch.dtype) -> None:
    """ValueError where numbers of the dtype lie too far apart for steps of so many seconds at the
    latest instant(s) s.
    """
    if isinstance(latest, Tensor):
        latest = largest(latest)
    apart = torch.finfo(dtype).eps * abs(latest)
    if apart > SHARE * step:
        wider = "" if dtype == torch.float64 else ", or torch.float64,"
        raise ValueError(
            f"steps of {step:g} s at t = {latest:g} s were given, where numbers of {dtype} lie "
            f"up to {apart:.2g} s apart; instants nearer to 0{wider} are wanted"
        )


class StepEnd(NamedTuple):
    """An instant t (...) s at an end of a step, none of its samples later than `latest` s; the
    shortest length of that step s, and whether it was the stepper's own.
    """

    t: Tensor
    latest: float
    step: float
    usual: bool

    @classmethod
    def of(
        cls, known: StepEnd | None, t: Tensor, lengths: Tensor, usual: bool
    ) -> tuple[StepEnd, float]:
        """That from which steps of `lengths` (...) s go on, by what is `known` of it; the longest
        of them. Raises ValueError as `check_digits`.
        """
        if known is not None and usual and known.usual:
            step = longest = known.step
        else:
            step = concrete(lengths).detach().amin().item() if lengths.numel() else math.inf
            longest = largest(lengths)
        latest = known.latest if known else largest(t)
        check_digits(step, latest, t.dtype)
        return cls(t, latest, step, usual), longest

    def later(self, t: Tensor, longest: float) -> StepEnd:
        """The other end of that step."""
        return self._replace(t=t, latest=self.latest + longest)


def explicit_instants(
    scene: Any, t: Tensor, digits: torch.dtype, begin: Tensor | None, options: Any
) -> Tensor:
    """Instants (n) s of an explicit method in the scene's dtype, which carries the steps that are
    known; begin (...) s: from which they count.
    """
    gap, latest = concrete(t).diff().min().item(), concrete(t).detach().abs().max()
    check_digits(gap, latest, digits)
    if begin is not None:
        latest = latest + concrete(begin).detach().abs()
    size = options.get("step_size") if isinstance(options, dict) else None
    check_digits(min(gap, size) if isinstance(size, float) else gap, latest, scene.dtype)
    return t.to(scene.dtype)


def begins_of(t: Tensor, dt: Tensor, steps: int) -> Tensor:
    """Instants (steps, ...) s in double precision from which steps of dt (0-dim) s go on, the first
    at t (...), without the rounding of sums; ValueError where the digits of dt's dtype do not carry
    them.
    """
    step = concrete(dt).item()
    check_digits(step, largest(t) + steps * step, dt.dtype)
    passed = torch.arange(steps, dtype=torch.float64, device=t.device) * dt.double()
    return t.double() + in_line(passed, t.shape)
