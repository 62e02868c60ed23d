"""Instants of runs: in double precision, whatever a scene is computed in, and told apart by enough
digits for the steps between them.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..core.validation import as_tensor, concrete, dtype_of, increasing
from .step_inputs import in_line

SHARE = 0.1  # of a step: what rounding may move its ends by


def instants_of(given: Any, scene: Any) -> tuple[Tensor, torch.dtype]:
    """Strictly increasing instants (n) s in double precision, and the dtype in which they came."""
    t = increasing("t", as_tensor(given, torch.float64, scene.device))
    return t, dtype_of(given)


def check_digits(step: float, latest: float | Tensor, *dtypes: torch.dtype) -> None:
    """ValueError where numbers of one of the dtypes lie too far apart for steps of so many seconds
    at the latest instant(s) s.
    """
    if isinstance(latest, Tensor):
        latest = concrete(latest).detach().abs().amax().item() if latest.numel() else 0.0
    coarse = torch.float32 if torch.float32 in dtypes else torch.float64
    apart = torch.finfo(coarse).eps * abs(latest)
    if apart > SHARE * step:
        wider = "" if coarse == torch.float64 else ", or torch.float64,"
        raise ValueError(
            f"steps of {step:g} s at t = {latest:g} s were given, where numbers of {coarse} lie "
            f"up to {apart:.2g} s apart; instants nearer to 0{wider} are wanted"
        )


def explicit_instants(
    scene: Any, t: Tensor, digits: torch.dtype, begin: Tensor | None, options: Any
) -> Tensor:
    """Instants (n) s of an explicit method in the scene's dtype, which carries the steps that are
    known; begin (...) s: from which they count.
    """
    gap, latest = concrete(t).diff().min().item(), concrete(t).detach().abs().max()
    if begin is not None:
        latest = latest + concrete(begin).detach().abs()
    size = options.get("step_size") if isinstance(options, dict) else None
    check_digits(min(gap, size) if isinstance(size, float) else gap, latest, digits, scene.dtype)
    return t.to(scene.dtype)


def begins_of(t: Tensor, dt: Tensor, steps: int) -> Tensor:
    """Instants (steps, ...) s from which steps of dt (0-dim) s go on, the first at t (...), without
    the rounding of sums; ValueError where digits do not carry them.
    """
    step = concrete(dt).item()
    check_digits(step, concrete(t).detach().abs() + steps * step, t.dtype)
    passed = torch.arange(steps, dtype=torch.float64, device=t.device) * dt.double()
    return (t.double() + in_line(passed, t.shape)).to(t)
