"""Structures: several beams and bodies with joints."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import torch
from torch import Tensor
from torchdiffeq import odeint

import torchbeam as tb

from .build import section
from .case import Case

G = 9.81  # m/s^2
MESH = "the measured error of this mesh, rounded up"
SMALL = "order 2 is exact for bending by end forces; what is left is of the load's square"


def elbow(force: float = 1e-4) -> tuple[Tensor, Tensor]:
    """Deflection out of its plane of a right angle of two legs under a force at its tip: both legs
    bend, and the first is twisted by F L; F L^3 (2/(3 EI) + 1/GJ).
    """
    load = tb.PointLoad(("leg", -1), force=(0, 0, force))
    state = tb.equilibrium(_elbow(section(GJ=0.8, EI=2.0, mass=1.0), [load]), tolerance=1e-12)
    return state["leg"].tip.position[2] / force, torch.tensor(2 / (3 * 2.0) + 1 / 0.8)


def elbow_modes() -> tuple[Tensor, Tensor]:
    """Frequencies 1 to 4 within its plane: the second leg moves along itself with the first's end,
    as a mass, and both turn alike at the corner (Euler and Bernoulli, roots of the determinant).
    """
    frequencies = tb.modes(_elbow(section(GJ=1.0, EI=1.0, mass=1.0), plane="xy"), count=4).frequency
    return frequencies, torch.tensor(_roots(_elbow_determinant, 4)) ** 2


def _elbow(of: tb.Section, effects: list[tb.Load] | None = None, plane: str | None = None):
    shape = dict(order=2, up=(0, 0, 1))
    parts = {
        "arm": tb.Beam.straight(1.0, 4, of, **shape),
        "leg": tb.Beam.straight(1.0, 4, of, root=(1.0, 0, 0), direction=(0, 1, 0), **shape),
    }
    corner = [tb.Weld(("arm", -1), ("leg", 0))]
    return tb.Scene(
        parts, effects or [], joints=corner, supports=[tb.Support(("arm", 0))], plane=plane
    )


def _shapes(b: float, x: float) -> Tensor:
    """cosh, sinh, cos, sin of b x and their first three derivatives over b^k: (derivative, 4)."""
    c, s, C, S = math.cosh(b * x), math.sinh(b * x), math.cos(b * x), math.sin(b * x)
    return torch.tensor([[c, s, C, S], [s, c, -S, C], [c, s, -C, -S], [s, c, S, -C]])


def _elbow_determinant(b: float) -> float:
    at_end, at_start = _shapes(b, 1.0), _shapes(b, 0.0)
    clamped = torch.stack((at_end[:, 0] - at_end[:, 2], at_end[:, 1] - at_end[:, 3]), -1)
    arm = torch.zeros(6, 2)
    arm[:3] = torch.stack((clamped[1], clamped[2], clamped[3] + b * clamped[0]))  # a mass of 1
    none = torch.zeros(4)
    leg = torch.stack((-at_start[1], -at_start[2], none, at_start[0], at_end[2], at_end[3]))
    return float(torch.linalg.det(torch.cat((arm, leg), -1) / math.exp(b)))


def _roots(function: Callable[[float], float], count: int) -> list[float]:
    """The first zeros above 0.3, by halves."""
    roots, low = [], 0.3
    while len(roots) < count:
        a, b = low, low + 0.05
        if function(a) * function(b) < 0:
            for _ in range(50):
                middle = (a + b) / 2
                a, b = (a, middle) if function(a) * function(middle) < 0 else (middle, b)
            roots.append((a + b) / 2)
        low += 0.05
    return roots


def portal(push: float = 1e-4) -> tuple[Tensor, Tensor]:
    """Sway of two clamped columns under a beam, all of length 1: 5 P/(84 EI) (slope-deflection)."""
    of, shape = section(GJ=1.0, EI=1.0, mass=1.0), dict(order=2, up=(0, 0, 1))
    parts = {
        "left": tb.Beam.straight(1.0, 2, of, direction=(0, 1, 0), **shape),
        "right": tb.Beam.straight(1.0, 2, of, root=(1.0, 0, 0), direction=(0, 1, 0), **shape),
        "beam": tb.Beam.straight(1.0, 2, of, root=(0, 1.0, 0), **shape),
    }
    scene = tb.Scene(
        parts,
        [tb.PointLoad(("left", -1), force=(push, 0, 0))],
        joints=[tb.Weld(("left", -1), ("beam", 0)), tb.Weld(("right", -1), ("beam", -1))],
        supports=[tb.Support(("left", 0)), tb.Support(("right", 0))],
        plane="xy",
    )
    state = tb.equilibrium(scene, tolerance=1e-12)
    return state["left"].tip.position[0] / push, torch.tensor(5 / 84)


def rotor(inertia: float = 0.5) -> tuple[Tensor, Tensor]:
    """Frequencies of three blades on a hub that turns freely, within its plane: first the two
    differential motions, of clamped blades, while the hub stands; then the collective one, J a =
    3 EI w''(0), w'(0) = a (roots of the characteristic equation); the same again of second modes.
    """
    of, third = section(GJ=1.0, EI=1.0, mass=1.0), 2 * math.pi / 3
    blades = {
        f"blade {k}": tb.Beam.straight(
            1.0,
            4,
            of,
            order=2,
            up=(0, 0, 1),
            direction=(math.cos(third * k), math.sin(third * k), 0),
        )
        for k in range(3)
    }
    scene = tb.Scene(
        {"hub": tb.Body(1.0, inertia), **blades},
        joints=[
            tb.Hinge(None, "hub", axis=(0, 0, 1)),
            *(tb.Weld("hub", (name, 0)) for name in blades),
        ],
        plane="xy",
    )

    def clamped(b: float) -> float:
        return math.cosh(b) * math.cos(b) + 1

    def collective(b: float) -> float:
        shapes, end = _shapes(b, 0.0), _shapes(b, 1.0)
        hub = inertia * b**3 * shapes[1] + 3 * shapes[2]
        rows = torch.stack((shapes[0], hub, end[2], end[3]))
        return float(torch.linalg.det(rows / math.exp(b)))

    one, two = _roots(clamped, 2)
    both, again = _roots(collective, 2)
    wanted = torch.tensor([one, one, both, two, two, again]) ** 2
    return tb.modes(scene, count=7).frequency[1:], wanted.sort()[0]


def pendulum(bodies: int) -> tuple[Tensor, Tensor]:
    """Places after 0.3 s of so many bars on hinges, of 1 kg, 0.1 kg m^2 and 1 m, that fall from
    the horizontal; against the equations of Lagrange by dopri8 at 1e-13. Of midpoint steps, whose
    errors are even in their size (Romberg 1955).
    """
    parts = {f"bar {k}": tb.Body(1.0, 0.1, position=(k + 0.5, 0, 0)) for k in range(bodies)}
    names = [None, *parts]
    joints = [
        tb.Hinge(names[k], names[k + 1], at=(float(k), 0, 0), axis=(0, 1, 0)) for k in range(bodies)
    ]
    scene = tb.Scene(parts, [tb.Gravity((0, 0, -G))], joints=joints, plane="xz")
    times, places = torch.tensor([0.0, 0.3]), []
    for steps in (6, 12, 24, 48):
        sizes = dict(step=0.3 / steps, tolerance=1e-13, engine="eager")
        places.append(tb.simulate(scene, times, **sizes).state[-1].position)
    for order in (4, 16, 64):
        places = [(order * fine - coarse) / (order - 1) for coarse, fine in pairwise(places)]
    return places[0], _pendulum(bodies, 0.3)


def _pendulum(n: int, t: float) -> Tensor:
    """Centres (n, 3) of the bars at t: sum_j M_ij cos(a_i - a_j) a_j'' = -sum_j M_ij sin(a_i -
    a_j) a_j'^2 - g_i sin a_i, with the angles a from the vertical.
    """
    lever = torch.tril(torch.ones(n, n), -1) + 0.5 * torch.eye(n)  # of a bar's centre, by angles
    mass, weight = lever.T @ lever, G * lever.sum(0)

    def rates(_: Tensor, y: Tensor) -> Tensor:
        a, v = y.split(n)
        apart = a[:, None] - a[None]
        force = -(mass * torch.sin(apart)) @ v**2 - weight * torch.sin(a)
        inertia = mass * torch.cos(apart) + 0.1 * torch.eye(n)
        return torch.cat((v, torch.linalg.solve(inertia, force)))

    start = torch.cat((torch.full((n,), math.pi / 2), torch.zeros(n)))
    times = torch.tensor([0.0, t])
    exact = dict(rtol=1e-13, atol=1e-13, options={"step_t": times[1:]})  # ends there
    a = odeint(rates, start, times, method="dopri8", **exact)[-1, :n]
    return torch.stack((lever @ torch.sin(a), 0 * a, -lever @ torch.cos(a)), -1)


def free() -> tuple[Tensor, Tensor]:
    """Momentum and angular momentum about the origin after 0.2 s, of two beams and four bodies that
    nothing holds, joined by one of each joint, with a spring, a damper and a motor: as at first,
    when all turned about an axis and bent with that.
    """
    of = section(EA=1e3, GA=5e2, GJ=0.7, mass=0.3, inertia=1e-3)
    bodies = ((1.0, 0, 0.2), (1.0, 0.3, 0.7), (1.3, 0.3, 0.7), (1.3, 0.6, 0.7))
    parts = {
        "arm": tb.Beam.straight(1.0, 2, of),
        "post": tb.Beam.straight(0.5, 2, of, root=(1.0, 0, 0.2), direction=(0, 0, 1)),
        **{
            f"body {k}": tb.Body(0.2, (2e-3, 3e-3, 4e-3), position=place)
            for k, place in enumerate(bodies)
        },
    }
    y, z = (0, 1.0, 0), (0, 0, 1.0)
    joints = [
        tb.Weld(("arm", -1), "body 0"),
        tb.Hinge("body 0", ("post", 0), axis=y, stiffness=1.0, damping=0.01, torque=0.2),
        tb.Ball(("post", -1), ("body 1", (0, -0.3, 0))),
        tb.Universal("body 1", ("body 2", (-0.3, 0, 0)), axis=y, second=z),
        tb.Slider("body 2", "body 3", axis=y, stiffness=3.0),
        tb.Cylindrical("body 3", ("arm", 0), axis=(1.0, 0, 0)),
        tb.Distance("body 3", ("post", 0)),
    ]
    scene = tb.Scene(parts, joints=joints)
    state, spin = tb.rest(scene), torch.tensor((0.5, 1.0, 2.0))
    place, axes, inertia = state.position, state.axes, tb.Stepper(scene, 0.01).model.inertia

    def momenta(state: tb.State) -> Tensor:
        P, H = inertia.momenta(state.rotation, state.velocity, state.spin)[:2]
        return torch.cat((P.sum(0), (torch.linalg.cross(state.position, P) + H).sum(0)))

    turning = replace(
        state,
        velocity=torch.linalg.cross(spin.expand_as(place), place),
        spin=(axes.mT @ spin[:, None])[..., 0],
    )
    options = dict(step=0.01, engine="eager", tolerance=1e-13, throw=True)
    last = tb.simulate(scene, [0.0, 0.2], turning, **options).state[-1]
    return momenta(last), momenta(turning)


def ring() -> tuple[Tensor, Tensor]:
    """Lengthening and narrowing of four welded arcs that two forces pull apart, over F R^3/EI:
    pi/4 - 2/pi and 2/pi - 1/2 (Timoshenko 1930); extrapolated from 4 and 8 elements an arc.
    """
    force, changes = 1e-3, []
    for elements in (4, 8):
        state = tb.equilibrium(_ring(force, elements), tolerance=1e-12)
        right, top, left, bottom = (state[f"arc {k}"].nodes[0] for k in range(4))
        changes.append(torch.stack(((right - left)[0] - 2, 2 - (top - bottom)[1])) / force)
    wanted = torch.tensor([math.pi / 4 - 2 / math.pi, 2 / math.pi - 0.5])
    return (4 * changes[1] - changes[0]) / 3, wanted


def _ring(force: float, elements: int) -> tb.Scene:
    """Of radius 1, held at one node half way, which carries nothing."""
    of, parts, joints = section(GJ=1.0, EI=1.0, mass=1.0), {}, []
    for k in range(4):
        s = torch.linspace(k * math.pi / 2, (k + 1) * math.pi / 2, elements + 1)
        nodes = torch.stack((torch.cos(s), torch.sin(s), 0 * s), -1)
        parts[f"arc {k}"] = tb.Beam.from_nodes(nodes, of)
        joints.append(tb.Weld((f"arc {k}", -1), (f"arc {(k + 1) % 4}", 0)))
    loads = [
        tb.PointLoad((f"arc {k}", 0), force=(sign * force, 0, 0)) for k, sign in ((0, 1), (2, -1))
    ]
    return tb.Scene(parts, loads, joints=joints, plane="xy", supports=[tb.Support(("arc 1", 0))])


def _case(name: str, source: str, quantity: str, mesh: str, solve: Callable, bound: float,
          why: str = MESH) -> Case:  # fmt: skip
    return Case(name, source, quantity, mesh, solve, bound, why)


STEPS = "what Newton's method and the extrapolation leave; places of up to 2.5 m"

# fmt: off
CASES = [
    _case("right-angle elbow (Simo and Vu-Quoc 1988)", "closed form",
          "deflection out of the plane", "2 x 4 elements of order 2", elbow, 1e-7, SMALL),
    _case("right-angle elbow, vibrations", "Euler and Bernoulli, 1e-12", "frequencies 1 to 4",
          "2 x 4 elements of order 2", elbow_modes, 7e-4),
    _case("portal frame", "closed form", "sway", "3 x 2 elements of order 2", portal, 1e-6, SMALL),
    _case("ring of four arcs, pulled", "closed form (Timoshenko 1930)",
          "lengthening and narrowing", "4 x 4 and 4 x 8 elements", ring, 9e-4),
    _case("three blades on a hub", "Euler and Bernoulli, 1e-12",
          "differential and collective frequencies", "3 x 4 elements of order 2", rotor, 5e-4),
    Case("free structure of seven joints", "conservation of both momenta",
         "momentum and angular momentum, kg m/s and kg m^2/s", "2 beams, 4 bodies, 20 steps", free,
         1e-12, "rounding, and what Newton's method leaves", 1.0),
    Case("double pendulum of bodies", "ODE of Lagrange, 1e-12", "places after 0.3 s, m",
         "2 bodies, midpoint", lambda: pendulum(2), 1e-10, STEPS, 1.0),
    Case("triple pendulum of bodies", "ODE of Lagrange, 1e-12", "places after 0.3 s, m",
         "3 bodies, midpoint", lambda: pendulum(3), 1e-10, STEPS, 1.0),
]
# fmt: on
