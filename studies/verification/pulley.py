"""A cable over a pulley that a hinge bears."""

from __future__ import annotations

import math

import torch
from torch import Tensor

import torchbeam as tb

from .case import Case

R, RADIUS, THICKNESS, G = 0.05, 0.001, 5e-4, 9.81
BODY_MASS, INERTIA, MASS = 0.3, 4e-4, 1e-3  # kg, kg m^2 about the axle; kg/m of the cable
TIME = 0.1  # s


def machine(
    left: float, right: float, turns: int = 16, straight: int = 2, friction: float | None = 0.8
) -> tb.Scene:
    """Atwood's machine: bodies of `left` and `right` kg at the ends of a cable, of so many elements
    over half a turn of the pulley and down to each of them.
    """
    level = (left + right) / 2 * G / R
    outer = R + RADIUS + THICKNESS / 2  # under four times that force: the gap is half
    a = torch.linspace(0, math.pi, turns + 1)
    over = torch.stack((-outer * torch.cos(a), 0 * a, outer * torch.sin(a)), -1)
    length = outer * math.pi / turns
    down = length * torch.arange(straight, 0, -1)
    at = [torch.stack((0 * down + x, 0 * down, -down), -1) for x in (-outer, outer)]
    nodes = torch.cat((at[0], over, at[1].flip(0)))
    section = tb.Section.from_stiffness(EA=2e3, GA=2e3, GJ=1e-4, EI=1e-5, mass=MASS, inertia=1e-9)
    parts = {"cable": tb.Beam.from_nodes(nodes, section, up=(-1.0, 0, 0))}
    parts["pulley"] = tb.Body(
        BODY_MASS, INERTIA, surface=tb.Capsule((0, -0.01, 0), (0, 0.01, 0), R)
    )
    for name, mass, node in (("left", left, 0), ("right", right, -1)):
        parts[name] = tb.Body(mass, 1e-5, position=tuple(nodes[node].tolist()))
    law = {} if friction is None else dict(friction=friction, slip_speed=1e-2)
    contact = tb.Contact(
        "cable", "pulley", radius=RADIUS, thickness=THICKNESS, force=4 * level, damping=1e-3, **law
    )
    joints = [
        tb.Hinge(None, "pulley", axis=(0, 1, 0)),
        tb.Ball(("cable", 0), "left"),
        tb.Ball(("cable", -1), "right"),
    ]
    effects = [contact, tb.Gravity((0, 0, -G)), tb.Damping(1e-3)]
    return tb.Scene(parts, effects, joints=joints, plane="xz")


def atwood() -> tuple[Tensor, Tensor]:
    """Mean acceleration of the bodies, that of the pulley times the cable's radius there, and the
    difference of the tensions, which is what turns the pulley.
    """
    m = 0.2, 0.15
    scene = machine(*m)
    run = tb.simulate(scene, [0.0, TIME], step=1e-3)
    radius = R + RADIUS + THICKNESS / 2

    def rate(x: tb.State) -> Tensor:
        return torch.stack((-x["left"].velocity[2], x["right"].velocity[2],
                            -radius * x["pulley"].spin[1]))  # fmt: skip

    mean = rate(run.state[-1]) / TIME  # from rest: less and less of it is how the cable tightens
    tensions = [(g - a) * own for g, a, own in ((G, mean[0], m[0]), (G, -mean[1], m[1]))]
    whole = sum(m) + INERTIA / radius**2 + MASS * float(scene.beam.length.sum())
    a = (m[0] - m[1]) * G / whole
    torque = INERTIA * a / radius**2
    ours = torch.cat((mean / a, ((tensions[0] - tensions[1]) / torque)[None]))
    return ours, torch.ones(4)


CASES = [
    Case("Atwood's machine over a pulley on a hinge", "(m - M) g/(m + M + I/R^2)",
         "acceleration of bodies and pulley, difference of tensions", "16 elements over it, 1 ms",
         atwood, 1e-2, "R by the cable's gap and polygon"),
]  # fmt: skip
