"""Error of single precision: distance of the answer in float32 from that in float64, by mesh and
step.
"""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

import torchbeam as tb

from .build import cantilever, motion, tip_force

ELEMENTS = (4, 8, 16, 32, 64)
STEPS = {2e-2: 10, 1e-2: 20, 1e-3: 20, 1e-4: 20, 1e-5: 20}  # dt in s -> steps


def precision_rows() -> list[dict]:
    """One row a mesh: static, P L^2/EI = 4 across; then the sudden load of 1 by dt, after 10 or 20
    steps. Each value is the distance of the tips over the distance that the tip has moved; None
    where float32 failed.
    """
    rows = []
    for N in ELEMENTS:
        row: dict = {
            "elements": N,
            "static": _distance(
                lambda p, N=N: tb.equilibrium(
                    cantilever(p, N, tip_force(p, 0, 4.0, 1.0)), throw=False
                )
            ),
        }
        for dt, steps in STEPS.items():
            row[f"dt = {dt:g} s"] = _distance(
                lambda p, N=N, dt=dt, steps=steps: motion(
                    cantilever(p, N, tip_force(p, 0, 1.0, 0.3)), steps, dt
                ).state[-1]
            )
        rows.append(row)
    return rows


def _distance(solve) -> float | None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        double, single = (
            solve(torch.ones(1, dtype=dtype)) for dtype in (torch.float64, torch.float32)
        )
    if (single.status != 0).any():
        return None
    start = torch.tensor([1.0, 0, 0], dtype=torch.float64)

    def tip(state: tb.State) -> Tensor:
        return state.tip.position.double() - start

    return ((tip(single) - tip(double)).norm() / tip(double).norm()).item()
