"""What data do not tell, in words: parameters that ran away, directions without a misfit."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

SHOWN = 0.1  # of a direction: smaller parts are not named


def undetermined(
    names: Sequence[str],
    theta: Tensor,
    start: Tensor,
    away: Tensor,
    J: Tensor,
    least: Tensor,
    resolution: float,
) -> tuple[tuple[str, ...], Tensor]:
    """Sentences about where one start ended, and which parameters (p,) bool they are about.

    theta, start  (p,);  away (p,) bool: which ran away;  J (T, p) by the parameters' own sizes
    least         change of the weighted values that could be seen;  resolution  relative accuracy
                  of J

    Named are parameters that ran away; those that change the values by no more than `least`;
    changes of several together that do so: right singular vectors of J, its columns scaled to one.
    """
    change = torch.linalg.vector_norm(J, dim=0)
    said = [
        f"{names[j]} ran away, from {start[j].item():.4g} to {theta[j].item():.4g}"
        for j in _true(away)
    ]
    said += [
        f"the misfit does not change with {names[j]} (here {theta[j].item():.4g})"
        for j in _true((change <= least) & ~away)
    ]
    open_ = away | (change <= least)
    some = _true(~open_)
    if len(some) > 1:
        _, singular, directions = torch.linalg.svd(J[:, some] / change[some], full_matrices=False)
        directions = directions / change[some]
        length = torch.linalg.vector_norm(directions, dim=-1)
        free = (singular <= resolution) | (singular / length <= least)
        for direction in (directions / length[:, None])[free]:
            parts = _true(direction.abs() > SHOWN)
            shares = (100 * direction * direction[parts[0]].sign()).tolist()
            together = ", ".join(f"{names[some[j]]} {shares[j]:+.0f} %" for j in parts)
            said.append(f"the misfit does not change where these change together: {together}")
            open_ = open_.clone()
            open_[[some[j] for j in parts]] = True
    return tuple(said), open_


def _true(mask: Tensor) -> list[int]:
    return mask.nonzero()[:, 0].tolist()
