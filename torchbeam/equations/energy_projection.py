"""What is left of the energy error of a step is taken out of its velocities."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..nodal.rows import Rows
from ..state.state import State

MOST = 0.01  # of the kinetic energy, that one step may take or give


def conserved(
    model: Rows, start: State, after: State, dt: Tensor, own: Tensor | float = 0.0
) -> State:
    """`after`, with the work of this step alone, and its velocities scaled so that kinetic + strain
    energy changes by that work less what damping takes, see `projected`. `own`: the strain that the
    beam takes by itself over this step, which holds no energy.
    """
    kinetic, rise = kinetic_rise(model, start, after)
    rise = rise + strain_rise(model, start, after, dt, own) - after.work
    scale, defect = projected(start.defect + rise, kinetic)
    scale = scale[..., None, None]
    return replace(after, velocity=scale * after.velocity, spin=scale * after.spin, defect=defect)


def kinetic_rise(model: Rows, start: State, after: State) -> tuple[Tensor, Tensor]:
    """(...) J: kinetic energy at the end, and what it has risen by."""
    kinetic = model.kinetic_energy(after.rotation, after.velocity, after.spin)
    return kinetic, kinetic - model.kinetic_energy(start.rotation, start.velocity, start.spin)


def strain_rise(model: Rows, start: State, after: State, dt: Tensor, own: Tensor | float) -> Tensor:
    """(...) J: what the strain energy rises by, and damping takes."""
    rise = model.strain_energy(after.position, after.rotation, own) - model.strain_energy(
        start.position, start.rotation, own
    )
    if not model.law.damped:
        return rise
    before, end = (model.strain(model.kinematics(s.position, s.rotation)) for s in (start, after))
    lost = model.law.dissipation(lambda: (end - before) / dt[..., None, None])
    return rise + (model.length * lost).sum((-1, -2)) * dt


def projected(defect: Tensor, kinetic: Tensor) -> tuple[Tensor, Tensor]:
    """Scale s of the velocities, s^2 = 1 - defect/kinetic, and the defect (J) that is left: what is
    more than `MOST` waits for a step with more kinetic energy.
    """
    change = (-defect / kinetic.clamp(min=torch.finfo(kinetic.dtype).tiny)).clamp(-MOST, MOST)
    return (1 + change).sqrt(), defect + change * kinetic
