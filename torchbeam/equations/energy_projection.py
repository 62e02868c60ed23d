"""What is left of the energy error of a step is taken out of its velocities; of pieces that float
free, out of those that bend them: of each the rigid motion with all of its momentum and its angular
momentum stays.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..nodal.constitutive_law import ElasticLaw
from ..nodal.rigid_moves import Base, moves_of
from ..nodal.rows import Rows
from ..state.state import State

MOST = 0.01  # of the kinetic energy, that one step may take or give
EPS = 64  # roundings: beside the largest inertia, one that is none


def conserved(
    model: Rows,
    start: State,
    after: State,
    dt: Tensor,
    eigenstrain: Tensor | float,
    free: list[list[Base]],
) -> State:
    """`after`, with the work of this step alone, and its velocities scaled so that kinetic + strain
    energy changes by that work less what damping takes, see `projected`. eigenstrain: what the beam
    takes by itself over this step, which holds no energy. free: the pieces that nothing holds.
    """
    kinetic, rise = kinetic_rise(model, start, after)
    rise = rise + strain_rise(model, start, after, dt, eigenstrain) - after.work
    velocity, spin = rigid = rigid_motion(model, after, free)
    kinetic = kinetic - model.kinetic_energy(after.position, after.rotation, *rigid)
    scale, defect = projected(start.defect + rise, kinetic)
    scale = scale[..., None, None]
    velocity = velocity + scale * (after.velocity - velocity)
    spin = spin + scale * (after.spin - spin)
    return replace(after, velocity=velocity, spin=spin, defect=defect)


def rigid_motion(model: Rows, state: State, pieces: list[list[Base]]) -> tuple[Tensor, Tensor]:
    """Velocities (..., N+1, p) and spins (..., N+1, s), section axes, of the rigid motions of
    pieces with the momentum and the angular momentum of each in a state in the coordinates of the
    model's space; none of all else.
    """
    space, inertia, rotation = model.space, model.inertia, state.rotation
    nodes = space.public_position(state.position)
    velocity, spin = torch.zeros_like(state.velocity), torch.zeros_like(state.spin)
    for piece in pieces:
        shift, turn = (x.unflatten(-3, (-1, 6)).sum(-4) for x in moves_of(nodes, piece))
        turns = (space.to_section(rotation, x) for x in space.project_spin(turn).unbind(-3))
        motions = [*zip(space.project_vector(shift).unbind(-3), turns, strict=True)]
        rates, momenta = [], []
        for v, w in (*motions, (state.velocity, state.spin)):
            v = inertia.centre_velocity(rotation, v, w)
            rates.append((v, w))
            momenta.append((inertia.translational.momentum(v), inertia.rotary.section_momentum(w)))
        rates, momenta = map(_in_rows, (rates, momenta))
        table = rates[..., :6, :] @ momenta.mT
        none = EPS * torch.finfo(table.dtype).eps
        share = torch.linalg.pinv(table[..., :6], rtol=none, hermitian=True) @ table[..., 6:]
        for k, (by_velocity, by_spin) in enumerate(motions):
            velocity = velocity + share[..., k, :, None] * by_velocity
            spin = spin + share[..., k, :, None] * by_spin
    return velocity, spin


def _in_rows(pairs: list[tuple[Tensor, Tensor]]) -> Tensor:
    """(..., n, all numbers) of n pairs of (..., N+1, *)."""
    rows = (torch.cat(pair, -1).flatten(-2) for pair in pairs)
    return torch.stack(torch.broadcast_tensors(*rows), -2)


def kinetic_rise(model: Rows, start: State, after: State) -> tuple[Tensor, Tensor]:
    """(...) J: kinetic energy at the end, and what it has risen by."""
    before, kinetic = (
        model.kinetic_energy(state.position, state.rotation, state.velocity, state.spin)
        for state in (start, after)
    )
    return kinetic, kinetic - before


def strain_rise(
    model: Rows, start: State, after: State, dt: Tensor, eigenstrain: Tensor | float
) -> Tensor:
    """(...) J: what the strain energy rises by, and damping and arms that relax take."""
    law = model.law
    if law.arms is None:
        rise = model.strain_energy(after.position, after.rotation, eigenstrain)
        rise = rise - model.strain_energy(start.position, start.rotation, eigenstrain)
        if not law.damped:
            return rise
    before, end = (model.strain(model.kinematics(s.position, s.rotation)) for s in (start, after))
    if law.arms is not None:
        rise = (model.length * _work_of_arms(law, start, before, end, dt, eigenstrain)).sum(
            (-1, -2)
        )
        if not law.damped:
            return rise
    lost = model.law.dissipation(lambda: (end - before) / dt[..., None, None])
    return rise + (model.length * lost).sum((-1, -2)) * dt


def _work_of_arms(
    law: ElasticLaw,
    start: State,
    before: Tensor,
    end: Tensor,
    dt: Tensor,
    eigenstrain: Tensor | float,
) -> Tensor:
    """(..., N, k) J/m: the work of the mean stress over a step, e C de = (e + de/2) C (e + de/2)/2
    - (e - de/2) C (e - de/2)/2, which is energy and what is dissipated.
    """
    mean, change = (before + end) / 2 - eigenstrain, end - before
    decay = law.arms.decay(dt[..., None, None])
    mean = law.arms.relaxed(
        mean, before - eigenstrain, change, start.inelastic, (decay.mean, decay.rising)
    )
    return law.energy(mean + change / 2) - law.energy(mean - change / 2)


def projected(defect: Tensor, kinetic: Tensor) -> tuple[Tensor, Tensor]:
    """Scale s of the velocities, s^2 = 1 - defect/kinetic, and the defect (J) that is left: what is
    more than `MOST` waits for a step with more kinetic energy.
    """
    change = (-defect / kinetic.clamp(min=torch.finfo(kinetic.dtype).tiny)).clamp(-MOST, MOST)
    return (1 + change).sqrt(), defect + change * kinetic
