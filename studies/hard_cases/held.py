"""Hard supports, moving frames and payloads."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

import torchbeam as tb

from .build import BASE, cantilever, energy_error, motion, moved, section, tip_force, vector
from .case import Answer, Case
from .dynamics import ENERGY, NOISE

RATE = 2 * math.pi  # rad/s, once spun up: m omega^2 L^4/EI = 8
RAMP = 2.0  # s, over which it is
PER_TURN = 24  # steps


def payload(p: Tensor, size: int) -> Answer:
    """20 kg at the tip of 0.2 kg of beam, off its axis and with inertia of its own, pushed
    suddenly.
    """
    body = tb.PointMass(20.0, inertia=(0.2, 0.1, 0.15), offset=(0.1, 0.05, 0.05))
    return moved(motion(cantilever(p, 8, tip_force(p, 0, 1.0, 0.3), body), size, 0.05))


def spun(by_frame: bool):
    """Spun up about a vertical axis to a turn a second, damped, under its weight, and for `size`
    turns: in the end it hangs as the equilibrium in a frame that turns steadily does. `by_frame`:
    by the motion of frame a, else of the clamp in it.
    """

    def solve(p: Tensor, size: int) -> Answer:
        effects = [tb.Gravity(vector(p, 0, 0, -9.81)), tb.Damping(0.1)]
        beam = cantilever(p, 8).beam
        axis = p.new_tensor([0.0, 0.0, 1.0])

        def rate(t: Tensor) -> Tensor:
            return RATE * (1 - torch.cos(math.pi * (t / RAMP).clamp(max=1))) / 2 * axis

        def angle(t: Tensor) -> Tensor:
            ramp = (t - RAMP / math.pi * torch.sin(math.pi * t / RAMP)) / 2
            return RATE * torch.where(t < RAMP, ramp, t - RAMP / 2) * axis

        held: dict[str, Any] = (
            dict(frame=tb.Frame(angular_velocity=rate))
            if by_frame
            else dict(root=tb.RootMotion(rotation=angle))
        )
        scene = tb.Scene(beam, effects, dtype=p.dtype, **held)
        steps = round((size + RAMP / 2) * PER_TURN)  # of which the ramp has half its time in turns
        sol = motion(scene, steps, 1 / PER_TURN, initial=tb.rest(scene, (len(p),)))
        steady = tb.equilibrium(
            tb.Scene(beam, effects, frame=tb.Frame(angular_velocity=RATE * axis), dtype=p.dtype)
        )
        return moved(sol, (sol.tip.position[-1] - steady.tip.position).norm(dim=-1).detach())

    return solve


def hinged(p: Tensor, size: int) -> Answer:
    """A pendulum let go from the horizontal, hinged about z: no stiffness against its fall."""
    scene = tb.Scene(
        cantilever(p, 8).beam,
        [tb.Gravity(vector(p, 0, -9.81, 1.0))],
        supports=tb.Support(0, rotation="xy"),
        dtype=p.dtype,
    )
    return moved(motion(scene, size, 0.01))


def free(p: Tensor, size: int) -> Answer:
    """A beam that nothing holds, pushed at one end: its momentum is the force's impulse."""
    force, dt = tip_force(p, 0, 1.0, 0.3), 0.01
    scene = tb.Scene(cantilever(p, 8).beam, [force], supports=(), dtype=p.dtype)
    sol = motion(scene, size, dt)
    share = p.new_tensor([0.5, *[1.0] * 7, 0.5]) * BASE["mass"] / 8
    momentum = (share[:, None] * sol.state.velocity[-1]).sum(-2)
    impulse = size * dt * force.force
    gap = ((momentum - impulse).norm(dim=-1) / impulse.norm(dim=-1)).detach()
    return moved(sol, torch.maximum(energy_error(sol), gap))


def spring(forces: float, moments: tuple[float, float, float], P: float):
    """An elastic clamp of the given stiffness, N/m and N m."""

    def solve(p: Tensor, size: int) -> Answer:
        stiffness = p.new_tensor([*[forces] * 3, *moments])
        scene = tb.Scene(
            cantilever(p, 8).beam,
            [tb.RootSpring(stiffness), tip_force(p, 0, P, P / 3)],
            dtype=p.dtype,
        )
        return moved(motion(scene, size, 0.01))

    return solve


def slender_in_plane(p: Tensor, size: int) -> Answer:
    """L over the radius of gyration 1e6, with three unknowns a node."""
    stiff = dict(EA=1e12, GA=0.37e12, inertia=0.2e-12)
    scene = tb.Scene(
        cantilever(p, 8, of=section(p, **stiff)).beam,
        [tip_force(p, 0, 0, 1.0)],
        plane="xz",
        dtype=p.dtype,
    )
    return moved(motion(scene, size, 0.01))


LAST_BIT = {"batch": "one 3x3 product rounds otherwise than a batch of them"}
# fmt: off
CASES = [
    Case("payload of 100 times the beam's mass",
         "the tip holds nearly all of the inertia, off the axis", ENERGY, payload,
         size=(100, 20)),
    Case("root spun through 20 revolutions", "rotation vectors of 40 pi, centrifugal stiffening",
         "tip from the steady equilibrium's", spun(False), bound=1e-2, size=(20, 2)),
    Case("frame spun through 20 revolutions", "gyroscopic and Euler terms",
         "tip from the steady equilibrium's", spun(True),
         bound=1e-2, size=(20, 2)),
    Case("hinged beam that falls", "the stiffness is singular: a pendulum", ENERGY, hinged,
         size=(100, 20)),
    Case("free beam, pushed", "six motions without stiffness",
         "energy less work, or momentum less impulse", free,
         size=(100, 20)),
    Case("clamp of 1e8 and 1 N m", "stiffness ratio 1e8 in the root's springs", ENERGY,
         spring(1e8, (1e8, 1e8, 1.0), 1.0),
         size=(100, 20), later=LAST_BIT),
    Case("clamp of 1e-4 N/m and N m", "springs 1e8 times softer than the beam", ENERGY,
         spring(1e-4, (1e-4,) * 3, 0.03),
         size=(100, 20), later=LAST_BIT),
    Case("slenderness 1e6 in the plane xz", "EA = 1e12 EI/L^2", ENERGY, slender_in_plane,
         size=(100, 20), gradient=1e-4,
         fails=NOISE),
]
# fmt: on
