"""Hints: what looks wrong in data and fit, in sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from torch import Tensor

from .readings import Readings

UNIT = 1000.0
NEAR = 5.0  # factor by which a start may be off that has the right unit


def unit_hints(readings: Sequence[Readings]) -> tuple[str, ...]:
    """Channels whose data are about a thousand times, or a thousandth of, what the model gives at the start."""
    said = []
    for one in readings:
        for label, data, y in one.channels():
            known = ~(data.isnan() | y.isnan())
            size, own = (v[known].square().mean().sqrt().item() for v in (data, y))
            if not size or not own or not math.isfinite(own):
                continue
            what, ratio = f"{label!r}" if label else "the data", size / own
            if UNIT / NEAR < ratio < UNIT * NEAR:
                said.append(f"{what}: the RMS of the data, {size:.3g}, is {ratio:.3g} times the model's at the start {own:.3g};"
                            " is a unit off by 1000 (mm for m, MPa for Pa, g for kg)?")
            elif UNIT / NEAR < 1 / ratio < UNIT * NEAR:
                said.append(f"{what}: the RMS of the model at the start, {own:.3g}, is {1 / ratio:.3g} times the data's, "
                            f"{size:.3g}; is a unit off by 1000 (m for mm, Pa for MPa, kg for g)?")
    return tuple(said)


def fit_hints(readings: Sequence[Readings], squares: float, freedom: int, sigma_given: bool) -> tuple[str, ...]:
    """A misfit above the noise that was stated, none by which noise could be known, and residuals of neighbouring instants that
    are alike.
    """
    said = []
    if not sigma_given and freedom < 1:
        said.append("there are as many parameters as data, and no sigma: the noise is not known, and stated deviations and "
                    "intervals say nothing")
    if sigma_given and freedom > 0 and squares > freedom + 5 * math.sqrt(2 * freedom):
        said.append(f"the misfit is {math.sqrt(squares / freedom):.3g} times what sigma says: noise is larger, or the model "
                    "does not explain the data, and stated intervals are too narrow")
    for one in readings:
        for label, data, y in one.channels():
            if one.times is None:
                continue
            order = one.times.argsort()
            r = (y - data)[order]
            r = r[~r.isnan()]
            if len(r) < 20 or not r.square().sum() > 0:
                continue
            alike = (r[1:] @ r[:-1] / (r @ r)).item()
            if alike > 5 / math.sqrt(len(r)):
                what = f" of {label!r}" if label else ""
                said.append(f"residuals{what} of neighbouring instants are alike (correlation {alike:.2f}): the model misses "
                            "something that is no noise, and stated intervals are too narrow")
    return tuple(said)


def bound_hints(names: Sequence[str], theta: Tensor, held: Tensor) -> tuple[str, ...]:
    """Parameters theta (p,) that a bound holds, `held` (p,) bool."""
    return tuple(f"{name} is at its bound, {value:.4g}, and the misfit falls beyond it: its interval is one-sided, and those "
                 "of others take it as it is"
                 for name, value, at in zip(names, theta.tolist(), held.tolist(), strict=True) if at)
