"""Contact with obstacles."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

import torchbeam as tb

from .case import Case

G, MASS, RADIUS = 9.81, 0.2, 0.01
LAW = dict(thickness=1e-3, force=4 * MASS * G, radius=RADIUS)
GRAVITY = tb.Gravity((0.0, 0.0, -G))
FLOOR = tb.Plane((0.0, 0, 0), (0.0, 0, 1.0))


def rod(inertia: float = 1e-5, elements: int = 2, height: float = RADIUS + 5e-4) -> tb.Beam:
    """A metre on a floor; by default the pressure at that height is the weight."""
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=MASS, inertia=inertia)
    return tb.Beam.straight(1.0, elements, section, root=(0.0, 0, height))


def weight() -> tuple[Tensor, Tensor]:
    """Force of the floor, and gap."""
    scene = tb.Scene(rod(height=RADIUS + 7e-4), [GRAVITY, tb.Contact(FLOOR, **LAW)], supports=())
    state = tb.equilibrium(scene, tolerance=1e-12)
    read = tb.sensors.ContactForce(scene)(state)[2], tb.sensors.ContactGap(scene)(state)[0]
    return torch.stack(read), torch.tensor([MASS * G, 1e-3 * (1 - 0.25**0.5)])


def bounce() -> tuple[Tensor, Tensor]:
    """The energy over three bounces from a height of 2 cm, over that at the start."""
    scene = tb.Scene(rod(height=0.03), [GRAVITY, tb.Contact(FLOOR, **LAW)], supports=())
    energy = tb.simulate(scene, torch.linspace(0, 0.4, 41), step=1e-3).energy
    total = energy.kinetic + energy.strain - energy.work
    assert energy.kinetic.max() > 0.03
    return 1 + total / (MASS * G * 0.02), torch.ones(41)


def moving(scene: tb.Scene, velocity: tuple[float, ...]) -> tb.State:
    state = tb.rest(scene)
    return replace(state, velocity=torch.tensor(velocity).expand_as(state.velocity))


def slope(friction: float, begin: float) -> tuple[tb.Solution, float]:
    """A rod on a floor at 20 degrees, that starts along it at rest in its gap; the angle."""
    angle = math.radians(20.0)
    down = G * torch.tensor([math.sin(angle), 0.0, -math.cos(angle)])
    law = LAW | dict(force=LAW["force"] * math.cos(angle))
    contact = tb.Contact(FLOOR, **law, friction=friction, slip_speed=1e-3)
    scene = tb.Scene(rod(), [tb.Gravity(down), contact], supports=())
    t = torch.linspace(0, 0.2, 11)
    initial = moving(scene, (begin, 0.0, 0.0))
    return tb.simulate(scene, t, step=2e-3, initial=initial), angle


def slides() -> tuple[Tensor, Tensor]:
    solution, angle = slope(0.1, 0.5)
    t, rate = solution.t, G * (math.sin(angle) - 0.1 * math.cos(angle))
    return solution.nodes[:, 1, 0], 0.5 + 0.5 * t + rate * t * t / 2


def holds() -> tuple[Tensor, Tensor]:
    """The way that what sticks creeps in 0.2 s, less that of the first 0.1 s."""
    solution, angle = slope(0.5, 0.0)
    share = math.tan(angle) / 0.5
    x = solution.nodes[:, 1, 0]
    return x[-1] - x[5], torch.tensor(1e-3 * (1 - math.sqrt(1 - share)) * 0.1)


def rolls() -> tuple[Tensor, Tensor]:
    """A rod that is thrown across itself without a spin, once it rolls: 2/3 of its speed."""
    contact = tb.Contact(FLOOR, **LAW, friction=0.5, slip_speed=1e-3)
    beam = rod(inertia=MASS * RADIUS**2 / 4)
    scene = tb.Scene(beam, [GRAVITY, contact], supports=())
    solution = tb.simulate(
        scene, torch.tensor([0.0, 0.2]), step=1e-3, initial=moving(scene, (0.0, 0.3, 0.0))
    )
    state = solution.state[-1]
    return torch.stack((state.velocity[1, 1], -RADIUS * state.spin[1, 0])), torch.tensor(0.2)


def capstan() -> tuple[Tensor, Tensor]:
    """Tension of a rope that is held over half a turn of a drum, which turns beneath it."""
    ours = []
    for spin in (20.0, -20.0):
        R, straight, d, P = 0.1, 0.1, 2e-4, 200.0
        s = torch.linspace(0, math.pi * R + 2 * straight, 61)
        turn, outer = ((s - straight) / R).clamp(0, math.pi), R + 0.7 * d
        down = (straight - s).clamp(min=0) + (s - straight - math.pi * R).clamp(min=0)
        nodes = torch.stack((-outer * torch.cos(turn), 0 * s, outer * torch.sin(turn) - down), -1)
        rope = tb.Section.from_stiffness(EA=2e3, GA=2e3, GJ=1e-3, EI=1e-6, mass=0.05, inertia=1e-7)
        contact = tb.Contact(
            tb.Cylinder((0.0, 0, 0), (0, 1.0, 0), R, spin=spin), thickness=d, force=P, friction=0.3,
            slip_speed=1e-3, damping=1e-3,
        )  # fmt: skip
        scene = tb.Scene(
            tb.Beam.from_nodes(nodes, rope),
            [tb.TipLoad(force=(0, 0, -1.0)), tb.MassDamping(60.0), tb.Damping(2e-4), contact],
            supports=[tb.Support(0, "xyz", "")],
            plane="xz",
        )
        ours.append(-tb.simulate(scene, torch.tensor([0.0, 0.6]), step=2e-3).root.force[-1, 2])
    ratio = math.exp(0.3 * math.pi)
    return torch.stack(ours), torch.tensor([ratio, 1 / ratio])


ROUNDING, MESH = "rounding", "the rope's polygon; twice its measured error"
CASES = [
    Case("weight on a floor", "Newton; the law of contact", "force and gap at rest", "2 elements",
         weight, 1e-10, ROUNDING),
    Case("bouncing on a floor", "conservation of energy", "energy over that of the fall",
         "2 elements, 1 ms", bounce, 1e-9, ROUNDING),
    Case("sliding down a slope", "Coulomb: g (sin a - mu cos a), 20 degrees, mu = 0.1", "place",
         "2 elements, 2 ms", slides, 5e-9,
         "what Newton's method leaves, 1e-8 of the largest force in a step"),
    Case("holding on a slope", "creep that the law states, 20 degrees, mu = 0.5", "way in 0.1 s",
         "2 elements, 2 ms", holds, 2e-3, "velocities of what sticks ring in the middle of steps"),
    Case("rolling on a floor", "momentum about the line of contact", "speed and spin, v0 = 0.3 m/s",
         "2 elements, 1 ms", rolls, 1e-10, ROUNDING),
    Case("capstan", "Euler and Eytelwein: exp(mu a), a = pi, mu = 0.3", "tension, either way",
         "60 elements, 2 ms", capstan, 1e-3, MESH),
]  # fmt: skip
