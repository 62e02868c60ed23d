"""Runaway motions: what an explicit method makes of steps beyond its limit of stability, while it
is still finite.

A beam has the energy that it starts with and that loads and supports give it; damping takes some.
Kinetic + strain - work can therefore not rise, but for the error of the steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.leaves import constant
from ..core.status import FAILED
from ..core.validation import concrete
from ..nodal.model import Model
from ..state.solution import Energy
from ..state.state import State
from .step_sequence import picked

MOST = 10.0  # times all energy that there was, that the steps may add
SENTENCE = "made energy that nothing gave: its step is beyond the limit of stability"


def stopped(model: Model, states: State, energies: Callable[[], Energy]) -> tuple[State, Tensor]:
    """States (time, ...) of which samples that run away keep the last one before, with the status
    FAILED; which these are (...).

    Samples are not judged where energy comes from elsewhere than work: from an eigenstrain that
    changes, or from supports that move, but for clamps.
    """
    scene = model.scene
    none = torch.zeros(states.status.shape[1:], dtype=torch.bool, device=states.status.device)
    carried = scene.has_prescribed_motion and not bool(model.constraints.fixed.all())
    if carried or not all(map(constant, scene.eigenstrains)):
        return states, none
    with no_derivatives():
        energy = energies()
        held = energy.kinetic + energy.strain
        had = held[0] + energy.work.abs().cummax(0).values + _rounding(model)
        wrong = held - held[0] - energy.work > MOST * had
        lost = wrong.any(0)
        if not concrete(lost).any():
            return states, none
        k = torch.arange(len(wrong), device=wrong.device)[(...,) + (None,) * lost.ndim]
        # the first one is what it starts with
        last = torch.where(lost, wrong.long().argmax(0) - 1, len(wrong) - 1)
        late = k > last
    before = picked(states, last).map(lambda x: x[None].expand(len(k), *x.shape))
    last_good = replace(before, t=states.t, status=torch.full_like(states.status, FAILED))
    return last_good.where(late, states), lost


def _rounding(model: Model) -> Tensor:
    """(...) J: what strains of the root of the arithmetic's precision store, by the largest
    stiffness against forces.
    """
    C, p = model.law.C, model.space.dims.position
    stiffness = (C if C.shape[-1] == 1 else C.diagonal(dim1=-2, dim2=-1)[..., None])[..., :p, 0]
    return torch.finfo(C.dtype).eps * (stiffness.amax(-1) * model.length[..., 0]).sum(-1).detach()
