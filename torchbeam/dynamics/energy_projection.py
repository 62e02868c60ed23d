"""What is left of the energy error of a step is taken out of its velocities."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..nodal.model import Model
from ..state.state import State

MOST = 0.01  # of the kinetic energy, that one step may take or give


def conserved(model: Model, start: State, after: State, dt: Tensor, own: Tensor | float = 0.0) -> State:
    """`after` with its velocities scaled by s, s^2 = 1 - defect/kinetic: kinetic + strain energy then changes by the work of
    the loads less what damping takes. What is more than `MOST` waits for a step with more kinetic energy. `own`: the strain
    that the beam takes by itself over this step, which holds no energy.
    """
    kinetic = model.kinetic_energy(after.rotation, after.velocity, after.spin)
    gain = (kinetic + model.strain_energy(after.position, after.rotation, own)
            - model.kinetic_energy(start.rotation, start.velocity, start.spin)
            - model.strain_energy(start.position, start.rotation, own))
    defect = start.defect + gain - (after.work - start.work)
    if model.law.damped:
        before, end = (model.strain(model.kinematics(s.position, s.rotation)) for s in (start, after))
        lost = model.law.dissipation(lambda: (end - before) / dt[..., None, None])
        defect = defect + (model.length * lost).sum((-1, -2)) * dt
    change = (-defect / kinetic.clamp(min=torch.finfo(kinetic.dtype).tiny)).clamp(-MOST, MOST)
    scale = (1 + change).sqrt()[..., None, None]
    return replace(after, velocity=scale * after.velocity, spin=scale * after.spin, defect=defect + change * kinetic)
