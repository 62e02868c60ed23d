"""Beams and bodies that touch each other."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions
from torchbeam.nodal.discretise import discretise

from .case import Case

RADIUS, EI, THICKNESS, FORCE = 0.004, 0.5, 1e-3, 800.0


def _section(EA: float = 1e6) -> tb.Section:
    """In the number format of whoever asks: a constant would keep that of the import."""
    return tb.Section.from_stiffness(EA=EA, GA=EA, GJ=0.4, EI=EI, mass=0.1, inertia=1e-6)


def pressed(distance: Tensor) -> Tensor:
    """N between two straight bars that cross at a right angle, of which the axes are so near: the
    law along one of them.
    """
    x = torch.linspace(-5, 5, 20001) * RADIUS
    y = THICKNESS - ((x * x + distance**2).sqrt() - 2 * RADIUS)
    over = (y - THICKNESS).clamp(min=0)
    p = FORCE / THICKNESS**2 * (y.clamp(min=0) ** 2 - over**2)
    return torch.trapezoid(p, x)


def crossed(down: float = 5e-3, a: float = 0.2) -> tuple[Tensor, Tensor]:
    """Force between the tips of two cantilevers that cross there, one of whose clamps is lowered:
    each gives way by F a^3/(3 EI) + F a/GA, and the law the rest.
    """
    lower = tb.Beam.straight(1.25 * a, 20, _section(), root=(0, -a, 0), direction=(0, 1, 0))
    start = 2 * RADIUS + THICKNESS
    upper = tb.Beam.straight(1.25 * a, 20, _section(), root=(-a, 0, start))
    contact = tb.Contact("lower", "upper", radius=RADIUS, thickness=THICKNESS, force=FORCE)
    supports = [tb.Support(("lower", 0)), tb.Support(("upper", 0), displacement=(0.0, 0.0, -down))]
    scene = tb.Scene({"lower": lower, "upper": upper}, [contact], supports=supports)
    state = tb.equilibrium(scene, engine="eager")
    low, high = torch.tensor(0.0), torch.tensor(10.0)
    for _ in range(60):  # by halves
        F = (low + high) / 2
        gives = 2 * F * (a**3 / (3 * EI) + a / 1e6)
        more = pressed(start - down + gives) > F
        low, high = torch.where(more, F, low), torch.where(more, high, F)
    force = tb.sensors.ContactForce(scene)(state)[2]
    return torch.stack((-force, state["lower"].root.force[2])), F.expand(2)


def held() -> tuple[Tensor, Tensor]:
    """A ball between two fingers that it bends apart, as it sinks under its weight: force of both
    on it, over the weight less what slows it.
    """
    m, r, mu, slow, g = 0.02, 0.015, 0.6, 1e-2, 9.81
    section = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=0.4, EI=0.05, mass=0.1, inertia=1e-6)
    parts: dict[str, tb.Beam | tb.Body] = {
        name: tb.Beam.straight(0.1, 4, section, root=(0, y, 0), direction=(0, 0, -1), up=(1, 0, 0))
        for name, y in (("left", -0.0189), ("right", 0.0189))
    }
    parts["ball"] = tb.Body(m, 0.4 * m * r**2, position=(0, 0, -0.075))
    law = dict(radius=RADIUS, other_radius=r, thickness=THICKNESS, force=2.0, damping=2e-3)
    contacts = [
        tb.Contact(name, "ball", **law, friction=mu, slip_speed=slow) for name in ("left", "right")
    ]
    effects = [*contacts, tb.Gravity((0, 0, -g)), tb.Damping(2e-3), tb.MassDamping(20.0)]
    supports = [tb.Support((name, 0)) for name in ("left", "right")]
    supports.append(tb.Support("ball", position="x", rotation="xyz"))  # else it rolls out, slowly
    scene = tb.Scene(parts, effects, supports=supports)
    state = tb.simulate(scene, [0.0, 0.1], step=1e-3).state[-1]
    left, right = (-tb.sensors.ContactForce(scene, k)(state) for k in (0, 1))
    drag = 20.0 * m * state["ball"].velocity[2]
    return (left + right)[2] / (m * g + drag), torch.tensor(1.0)


def collision() -> tuple[Tensor, Tensor]:
    """Momentum and the angular one of two free rods after they have met, with friction."""
    rods = {
        "a": tb.Beam.straight(0.12, 3, _section(1e3), root=(-0.06, 0, 0)),
        "b": tb.Beam.straight(
            0.1, 3, _section(1e3), root=(0.01, -0.05, 0.0087), direction=(0.1, 1, 0)
        ),
    }
    law = dict(radius=RADIUS, thickness=THICKNESS, force=FORCE, points=8)
    contact = tb.Contact("a", "b", **law, friction=0.3, slip_speed=0.1)
    scene = tb.Scene(rods, [contact])
    start = tb.rest(scene)
    velocity = start.velocity.clone()
    velocity[4:] = torch.tensor([0.3, 0.1, -1.0])
    start = replace(start, velocity=velocity)
    times = torch.linspace(0, 3e-3, 4)
    run = tb.simulate(scene, times, step=2.5e-4, initial=start, engine="eager", tolerance=1e-12)
    momenta = torch.stack([_momenta(scene, run.state[k]) for k in (0, -1)])
    assert run.energy.work.min() < -1e-3
    scale = momenta[0].abs().amax()
    return momenta[1] / scale, momenta[0] / scale


def _momenta(scene: tb.Scene, state: tb.State) -> Tensor:
    """Linear and angular momentum (6), by the masses of the nodal form."""
    inertia = discretise(scene).inertia
    moves = torch.cat((state.velocity, 0 * state.velocity), -1)
    p = inertia.masses(torch.eye(3)[None]).times(moves)[..., :3]
    spins = (inertia.rotary.J @ state.spin[..., None])[..., 0]
    turning = quaternions.rotate(state.rotation, spins)
    return torch.cat((p.sum(-2), (torch.linalg.cross(state.position, p) + turning).sum(-2)), -1)


def balls() -> tuple[Tensor, Tensor]:
    """Two balls of masses 1 and 2 that meet centrally: speeds after it, -1/3 and 2/3."""
    bodies = {"a": tb.Body(0.05, 1e-5), "b": tb.Body(0.1, 1e-5, position=(0.024, 0.006, 0))}
    scene = tb.Scene(bodies, [tb.Contact("a", "b", radius=0.01, thickness=1e-3, force=10.0)])
    start = tb.rest(scene)
    line = torch.tensor([1.0, 0.25, 0])
    start = replace(start, velocity=torch.stack((line, 0 * line)))
    run = tb.simulate(scene, [0.0, 0.02], step=5e-4, initial=start, engine="eager",
                      tolerance=1e-13)  # fmt: skip
    ours = torch.stack([run[name].velocity[-1] @ line / line.square().sum() for name in "ab"])
    return ours, torch.tensor([-1 / 3, 2 / 3])


CASES = [
    Case("two crossed cantilevers", "F = law(gap), gap by 2 F a^3/(3 EI)", "force, read twice",
         "20 elements each", crossed, 5e-3,
         "elements of first order: 1/(4 N^2) in the deflection; large displacements"),
    Case("ball held by two fingers", "Newton: mu N holds it", "weight",
         "4 elements each, 1 ms", held, 1e-2, "what still moves"),
    Case("two rods collide", "conservation of both momenta", "after contact with friction",
         "3 elements each, 0.25 ms", collision, 1e-12, "rounding"),
    Case("two balls collide", "conservation of energy and momentum", "speeds", "0.5 ms", balls,
         1e-10, "rounding of 40 solves"),
]  # fmt: skip
