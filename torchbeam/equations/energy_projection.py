"""What is left of the energy error of a step is taken out of its velocities; of what floats free,
out of those that bend it: a rigid motion with all of the momentum and the angular momentum stays.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..nodal.rows import Rows
from ..state.state import State

MOST = 0.01  # of the kinetic energy, that one step may take or give
EPS = 64  # roundings: beside the largest inertia, one that is none


def conserved(
    model: Rows, start: State, after: State, dt: Tensor, own: Tensor | float, floats: bool
) -> State:
    """`after`, with the work of this step alone, and its velocities scaled so that kinetic + strain
    energy changes by that work less what damping takes, see `projected`. `own`: the strain that the
    beam takes by itself over this step, which holds no energy. floats: whether nothing holds it.
    """
    kinetic, rise = kinetic_rise(model, start, after)
    rise = rise + strain_rise(model, start, after, dt, own) - after.work
    velocity, spin = rigid = rigid_motion(model, after) if floats else (0.0, 0.0)
    if floats:
        kinetic = kinetic - model.kinetic_energy(after.rotation, *rigid)
    scale, defect = projected(start.defect + rise, kinetic)
    scale = scale[..., None, None]
    velocity = velocity + scale * (after.velocity - velocity)
    spin = spin + scale * (after.spin - spin)
    return replace(after, velocity=velocity, spin=spin, defect=defect)


def rigid_motion(model: Rows, state: State) -> tuple[Tensor, Tensor]:
    """Velocities (..., N+1, p) and spins (..., N+1, s), section axes, of the rigid motion with the
    momentum and the angular momentum of a state in the coordinates of the model's space.
    """
    space, inertia, rotation = model.space, model.inertia, state.rotation
    nodes = space.public_position(state.position)
    arm = nodes - nodes.mean(-2, keepdim=True)
    size = torch.linalg.vector_norm(arm, dim=-1).amax(-1)[..., None, None]
    size = torch.where(size > 0, size, 1.0)  # of a body alone
    arm = arm / size
    still = torch.zeros_like(arm)
    motions = []
    for e in torch.eye(3, dtype=arm.dtype, device=arm.device):
        turn = e / size + still
        about = torch.linalg.cross(e.expand_as(arm), arm)
        motions += [
            (space.project_vector(shift), space.to_section(rotation, space.project_spin(spin)))
            for shift, spin in ((e + still, still), (about, turn))
        ]

    def momenta(velocity: Tensor, spin: Tensor) -> Tensor:
        """(..., 6) along the six motions."""
        centre = inertia.centre_velocity(rotation, velocity, spin)
        linear = inertia.translational.momentum(centre)
        angular = inertia.rotary.section_momentum(spin)
        along = [
            (centre * linear).sum((-1, -2))
            + inertia.rotary.present_or(0.0, lambda turn=turn: (turn * angular).sum((-1, -2)))
            for centre, turn in ((inertia.centre_velocity(rotation, *m), m[1]) for m in motions)
        ]
        return torch.stack(along, -1)

    mass = torch.stack([momenta(*motion) for motion in motions], -1)
    none = EPS * torch.finfo(mass.dtype).eps
    share = (
        torch.linalg.pinv(mass, rtol=none, hermitian=True)
        @ momenta(state.velocity, state.spin)[..., None]
    )
    return tuple(
        sum(share[..., k, :, None] * motion[i] for k, motion in enumerate(motions)) for i in (0, 1)
    )


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
