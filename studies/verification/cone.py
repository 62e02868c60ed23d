"""A beam that tapers, on a floor: a cone whose surface is that of balls about its axis."""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import quaternions

from .case import Case

G, RHO, LENGTH, APEX, STEEP, THICKNESS = 9.81, 1000.0, 0.4, 0.1, 0.1, 1e-3
# of the gap, y = thickness - gap = DEEP r: m g = RHO pi r^2 G = force (y/thickness)^2
FORCE = 4 * RHO * math.pi * (STEEP * (APEX + LENGTH)) ** 2 * G
DEEP = THICKNESS * math.sqrt(RHO * math.pi * G / FORCE)


def cone(elements: int, order: int = 1, **law: float) -> tb.Scene:
    """Of radii STEEP (APEX + s), as it lies on a floor at rest, its apex above frame a's origin:
    the weight per length goes by r^2, so that the gap is linear and the axis straight.
    """
    slope = STEEP * (1 - DEEP)
    radii = STEEP * APEX, STEEP * (APEX + LENGTH)
    beam = tb.Beam.straight(
        LENGTH, elements, lambda s: tb.Section.circle(STEEP * (APEX + s), E=1e9, nu=0.3, rho=RHO),
        direction=(math.sqrt(1 - slope**2), 0.0, slope),
        root=(APEX * math.sqrt(1 - slope**2), 0.0, THICKNESS + APEX * slope), order=order,
    )  # fmt: skip
    floor = tb.Contact(
        tb.Plane((0.0, 0, 0), (0.0, 0, 1.0)), radius=tb.Table((0.0, LENGTH), radii),
        thickness=THICKNESS, force=FORCE, **law,
    )  # fmt: skip
    return tb.Scene(beam, [tb.Gravity((0.0, 0.0, -G)), floor], supports=())


def lies() -> tuple[Tensor, Tensor]:
    """Gaps at all points, over the thickness, from a start 0.2 mm above."""
    scene = cone(8, order=2)
    start = tb.rest(scene)
    moved = start.position + torch.tensor([0.0, 0.0, 2e-4])
    state = tb.equilibrium(scene, initial=replace(start, position=moved), tolerance=1e-12)
    gap = tb.sensors.ContactPoints(scene)(state)[:, 6]
    nodes = torch.linspace(0.0, LENGTH, 9)  # of ends; two points in each element
    middle, half = (nodes[:-1] + nodes[1:]) / 2, LENGTH / 16 / math.sqrt(3)
    s = torch.stack((middle - half, middle + half), -1).flatten()
    return gap / THICKNESS, 1 - DEEP * STEEP * (APEX + s) / THICKNESS


def rolls(rate: float = 2.0, time: float = 0.5) -> tuple[Tensor, Tensor]:
    """A turn about the apex by `rate` without slip: the angle by which the tip goes round, over
    that of the rate, and the spin about the axis, -rate/sin a and what the turn has of it there.
    """
    scene = cone(4, friction=0.5, slip_speed=1e-4, damping=1e-3)
    start, up = tb.rest(scene), torch.tensor([0.0, 0.0, rate])
    axes = quaternions.matrix(start.rotation)
    spin = (axes.mT @ up) - torch.tensor([rate / STEEP, 0.0, 0.0])
    velocity = torch.linalg.cross(up.expand_as(start.position), start.position)
    start = replace(start, velocity=velocity, spin=spin)
    run = tb.simulate(scene, torch.linspace(0.0, time, 6), step=2e-3, initial=start)
    x, end = run.nodes[1:, -1], run.state[-1]
    angle = torch.atan2(x[:, 1], x[:, 0]) / (rate * run.t[1:])
    own = end.spin[:, 0] / (-rate / STEEP + rate * STEEP * (1 - DEEP))
    ours = torch.cat((angle, own))
    return ours, torch.ones_like(ours)


CASES = [
    Case("cone at rest on a floor", "its weight per length in the law of contact",
         "gaps, over the thickness", "8 elements of order 2", lies, 1e-9, "rounding"),
    Case("cone rolling about its apex", "kinematics: spin = -rate/sin a", "angle, and spin",
         "4 elements, 2 ms", rolls, 7e-5, "creep of what sticks, by its slip speed"),
]  # fmt: skip
