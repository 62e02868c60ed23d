"""A plectoneme: a rod of radius R and bending stiffness B, pulled by F and twisted by M until two
strands of it wind about each other, at an angle a to their common axis:

    F R^2/B = sin^3 a (cos a tan 2a - sin a/2)
    M = 2/sin 2a (B sin^4 a/(2 R) + R F)
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

import torchbeam as tb

from .case import Case
from .knot import arclength

# in radii of the rod: straight ends, bends to them, the loop's height and half of its width, the
# length over which all is smoothed
HALF_TURNS, TAIL, BEND, HEIGHT, BULGE, ROUNDED = 5, 14.0, 5.0, 8.0, 2.5, 1.5
ANGLE, LAYER, ELEMENT = 0.4, 0.1, 0.75  # rad for which it is pulled; radii: of contact, of a mesh
TORSION = 0.75  # GJ/B
# until when, steps, drag: less of it for the last, as it slows the strands down as they slide
STAGES = (2.0, 0.02, 0.02), (20.0, 0.1, 0.02), (150.0, 0.5, 0.02), (900.0, 1.0, 0.005)


def law(a: float, R: float = 1.0) -> tuple[float, float]:
    """F and M at an angle a (rad) of strands of radius R, B = 1."""
    F = math.sin(a) ** 3 * (math.cos(a) * math.tan(2 * a) - math.sin(a) / 2) / R**2
    return F, 2 / math.sin(2 * a) * (math.sin(a) ** 4 / (2 * R) + R * F)


def angle(F: float, R: float) -> float:
    """The angle (rad) at which strands of radius R bear F, by bisection."""
    low, high = 0.0, math.pi / 4 - 1e-9
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if law(middle, R)[0] < F else (low, middle)
    return low


def drawn() -> Tensor:
    """Nodes (N+1, 3) of the rod, from the origin along x, up a strand about z, round a loop, and
    down another.
    """
    turn = torch.linspace(0, HALF_TURNS * math.pi, 4001)
    wide = math.exp((ROUNDED * math.sin(ANGLE)) ** 2 / 2)  # 1, once that is smoothed
    strand = torch.stack((wide * turn.cos(), wide * turn.sin(), turn / math.tan(ANGLE)), -1)
    u = torch.linspace(0, math.pi, 2001)[1:-1]
    loop = torch.stack((wide * u.cos() + BULGE * (2 * u).sin(), 0 * u, HEIGHT * u.sin()), -1)
    loop[:, 2] += strand[-1, 2]
    u = torch.linspace(0, math.pi / 2, 1001)[1:]
    bend = torch.stack((wide + BEND - BEND * u.cos(), 0 * u, -BEND * u.sin()), -1)
    tail = bend[-1] + torch.linspace(0, TAIL, 2001)[1:, None] * torch.tensor([1.0, 0, 0])
    end, turned = torch.cat((bend, tail)), torch.tensor([-1.0, -1, 1])
    curve = torch.cat((turned * end.flip(0), turned * strand, loop, strand.flip(0), end))
    curve = evenly(curve, 6001)
    s = arclength(curve)
    bell = (-(((s - s[3000]) / ROUNDED) ** 2) / 2).exp()[2800:3201]
    curve = torch.nn.functional.conv1d(curve.mT[:, None], (bell / bell.sum())[None, None])[:, 0].mT
    return evenly(curve - curve[0], round(float(s[-1]) / ELEMENT))


def evenly(curve: Tensor, count: int) -> Tensor:
    """As many points, evenly along a polyline (M, 3)."""
    s = arclength(curve)
    return interpolated(s, curve, torch.linspace(0, float(s[-1]), count))


def interpolated(x: Tensor, values: Tensor, at: Tensor) -> Tensor:
    """Values (n, c) at x (n), which rises, linearly at `at` (m)."""
    k = torch.searchsorted(x, at).clamp(1, len(x) - 1)
    share = (at - x[k - 1]) / (x[k] - x[k - 1])
    return torch.lerp(values[k - 1], values[k], share[:, None])


def plectoneme() -> tuple[tb.Scene, tb.State]:
    """A rod that was straight, so wound, without shear and extension to speak of; its one end
    slides along x, and neither turns.
    """
    nodes = drawn()
    F, M = law(ANGLE)
    section = tb.Section.from_stiffness(
        EA=100.0, GA=100.0, GJ=TORSION, EI=1.0, mass=1.0, inertia=0.25
    )
    straight = arclength(nodes)[:, None] * torch.tensor([1.0, 0, 0])
    touching = tb.SelfContact(radius=1 - LAYER / 2, thickness=LAYER, force=1.0)
    scene = tb.Scene(
        tb.Beam.from_nodes(straight, section),
        [touching, tb.PointLoad(-1, force=(F, 0, 0)), tb.Damping(0.1)],
        supports=[tb.Support(0), tb.Support(-1, "yz", "xyz")],
    )
    # a turn more than M asks for, which the strands take up as they tighten; whole ones for ends
    # that are held as they were
    pinned = replace(scene, supports=(tb.Support(0), tb.Support(-1, "yz", "")))
    axes = tb.State.from_nodes(pinned, nodes).axes[-1]
    turned = math.atan2(float(axes[2, 1]), float(axes[1, 1]))
    whole = round((turned - M * float(straight[-1, 0]) / TORSION) / (2 * math.pi)) - 1
    return scene, tb.State.from_nodes(scene, nodes, twist=2 * math.pi * whole - turned)


def at_rest() -> tuple[Tensor, Tensor]:
    """M and a of the plectoneme, once it has come to rest in a medium that drags on it, and those
    of the law for its F and the radius that its strands keep.
    """
    scene, state = plectoneme()
    for until, step, drag in STAGES:
        within = replace(scene, effects=[*scene.effects, tb.MassDamping(drag)])
        t = [float(state.t), until]
        run = tb.simulate(within, t, state, "generalized_alpha", step=step, rho_inf=0.3)
        assert (run.status == 0).all()
        state = run.state[-1]
    R = 1 - LAYER / 2 + float(tb.sensors.ContactGap(scene)(state)[0]) / 2
    a = angle(law(ANGLE)[0], R)
    twisting = state.stress[:, 3].abs().mean()
    return torch.stack((twisting, wound(state, R))), torch.tensor([law(a, R)[1], a])


def wound(state: tb.State, R: float) -> Tensor:
    """The angle of strands of radius R in the middle of their height, by how fast they turn."""
    z = state.position[:, 2]
    top = int(z.argmax())
    heights = z[top] * torch.linspace(0.3, 0.6, 61)
    sides = []
    for part in (slice(0, top + 1), slice(top, None)):
        order = z[part].argsort()
        sides.append(interpolated(z[part][order], state.position[part, :2][order], heights))
    across = sides[1] - sides[0]
    turn = torch.atan2(across[:, 1], across[:, 0])
    turned = torch.remainder(turn.diff() + math.pi, 2 * math.pi) - math.pi
    return (R * turned.sum().abs() / (heights[-1] - heights[0])).atan()


CASES = [
    Case("plectoneme", "Clauvelin, Audoly and Neukirch, Biophys. J. 96, 3716 (2009)",
         "twisting moment, and angle of the strands, under a pull", "elements of 0.75 R", at_rest,
         3e-2, "twice its measured error"),
]  # fmt: skip
