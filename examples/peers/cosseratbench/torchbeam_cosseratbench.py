"""torchbeam as a solver of cosseratbench 0.3.0 (entry point `cosseratbench.solvers`).

Rods that are held alike are one batch. They move first as if nothing but the obstacles were there;
those that came near each other, or themselves, move again from there on, with contact between them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
import torch
from cosseratbench.scenario import (
    Cylinder,
    End,
    EndCondition,
    Motion,
    Plane,
    Rod,
    Scenario,
    neighbour_elements,
)
from cosseratbench.solver import Capability, Diverged
from cosseratbench.trajectory import Trajectory

import torchbeam as tb
from torchbeam.extend import quaternions as quat

STEP = 0.02  # over the slowest angular frequency
TOUCHING = 4  # parts of that where anything touches
FINER = 2  # elements in one of the suite's where there are several rods, which cross in a place
LAYER = 0.3  # thickness of the contact, over the radius: so that the rod lies on its surface
STIFF = 20.0  # force where surfaces meet, over what is expected to press
FLAT, FALLS = 0.08, 8.0  # the first on a plane, and times the second: there rods fall
SLIP = 3e-3  # slip speed, over the rod's length, 1/s
HOLDS = 5e-4  # the same round a cylinder, where friction holds a weight
DAMPING = 5e-3  # s, of the contact
POINTS = 4  # of an element at which it may touch an obstacle
NODES = {End.START: 0, End.END: -1}
SHEAR = 27 / 28  # coefficient of a circular section, as the suite's other solver has it


Motions = tuple[torch.Tensor, ...]  # (time, N+1, ...) of places, rotations, velocities, spins


class TorchbeamSolver:
    """Geometrically exact beams, two elements in one of order 2 until rods touch: by generalised
    alpha where the scenario is quasi-static, and motion is damped by its mass, critically for the
    slowest mode; else by the midpoint rule of fourth order, or of second where there are obstacles.
    Rods that touch are of order 1 and move by the midpoint rule.
    """

    name = "torchbeam"
    backend_version = version("torchbeam")
    capabilities = frozenset(Capability)

    def __init__(self, time_step_scale: float = 1.0) -> None:
        self.scale = time_step_scale

    def settings(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> dict[str, Any]:
        times = np.linspace(0, scenario.duration, n_frames)
        others = scenario.obstacles or (None,)
        laws = [_law(scenario, rod, other) for rod in scenario.rods for other in others]
        return {
            "integrator": _method(scenario)["method"],
            "integrator_touching": "midpoint",
            "damping_rate": _damping(scenario),
            "elements": _finer(scenario) * n_elements,
            "time_step": self._step(scenario, times, bool(scenario.obstacles)),
            "time_step_touching": self._step(scenario, times, True),
            "contact": [{k: float(v) for k, v in law.items()} for law in laws],
        }

    def run(self, scenario: Scenario, *, n_elements: int, n_frames: int) -> Trajectory:
        """Raises NotImplementedError for an end that slides along no axis of the world."""
        times = np.linspace(0.0, scenario.duration, n_frames)
        rods, finer = scenario.rods, _finer(scenario)
        step = self._step(scenario, times, bool(scenario.obstacles))
        motions: dict[int, Motions] = {}
        for alike in _alike(rods):
            scene, start = _batch(scenario, [rods[i] for i in alike], finer * n_elements)
            states = _motion(scene, start, times, step, **_method(scenario))
            motions |= {i: _of(states, k) for k, i in enumerate(alike)}
        met = _met(scenario, [motions[i][0] for i in range(len(rods))])
        step = self._step(scenario, times, True)
        for together in _components(len(rods), met):
            k = min(frame for pair, frame in met.items() if pair[0] in together)
            now = {i: tuple(x[k] for x in motions[i]) for i in together}
            scene, start = _structure(scenario, now, met, float(times[k]))
            states = _motion(scene, start, times[k:], step, method="midpoint")
            for i in together:
                both = zip(motions[i], _of(states[f"rod{i}"], 0), strict=True)
                motions[i] = tuple(torch.cat((x[:k], y)) for x, y in both)
        moved = [[x[:, ::finer] for x in motions[i]] for i in range(len(rods))]
        return Trajectory(
            times,
            tuple(x.numpy() for x, *_ in moved),
            tuple(_directors(x, q).numpy() for x, q, *_ in moved),
        )

    def _step(self, scenario: Scenario, times: np.ndarray, touching: bool) -> float:
        """s, a part of the interval between frames."""
        most = STEP * self.scale / scenario.slowest_frequency() / (TOUCHING if touching else 1)
        return float(times[1] / math.ceil(times[1] / most))


def _finer(scenario: Scenario) -> int:
    return FINER if len(scenario.rods) > 1 else 1


def _method(scenario: Scenario) -> dict[str, Any]:
    """Of a motion in which rods do not touch."""
    if scenario.quasi_static:
        return {"method": "generalized_alpha", "rho_inf": 0.5}
    return {"method": "midpoint" if scenario.obstacles else "midpoint4"}


def _motion(
    scene: tb.Scene, start: tb.State, times: np.ndarray, step: float, **method: Any
) -> tb.State:
    solution = tb.simulate(scene, torch.as_tensor(times), start, step=step, **method)
    failed = solution.status != 0
    if failed.any():
        raise Diverged("torchbeam's Newton method did not converge")
    return solution.state


def _of(states: tb.State, k: int) -> Motions:
    """Places, rotations, velocities and spins of a batch's k-th rod, time first."""
    parts = states.position, states.rotation, states.velocity, states.spin
    return tuple(x[:, k] for x in parts)


# A rod as a beam


def _beam(
    rods: Sequence[Rod], elements: int, touching: bool = False
) -> tuple[tb.Beam, torch.Tensor]:
    """The beam, straight at rest, of a batch of rods, and where its nodes are (k, N+1, 3) m; of
    order 2, half as many elements, where there can be and rods do not touch, which order 1 is for.
    """
    nodes = torch.tensor(np.stack([rod.nodes(elements) for rod in rods]))
    first, last, rod = nodes[:, 1] - nodes[:, 0], nodes[:, -1] - nodes[:, 0], rods[0]
    both = rod.start is rod.end is EndCondition.CLAMPED
    numbers = {
        name: torch.tensor([getattr(x.material, name) for x in rods])
        for name in ("youngs_modulus", "shear_modulus", "density")
    }
    r = torch.tensor([x.radius for x in rods])
    E, G, rho = numbers.values()
    A, second = math.pi * r**2, math.pi * r**4 / 4
    section = tb.Section.from_stiffness(
        EA=E * A,
        GA=SHEAR * G * A,
        GJ=2 * G * second,
        EI=E * second,
        mass=rho * A,
        inertia=rho * second,
    )
    order = 1 if touching or elements % 2 else 2
    beam = tb.Beam.straight(
        torch.tensor([x.length for x in rods]),
        elements // order,
        section,
        last if both else first,
        torch.tensor([x.normal for x in rods]),
        root=nodes[:, 0],
        order=order,
    )
    return beam, nodes


def _supports(
    rods: Sequence[Rod], beam: tb.Beam, nodes: torch.Tensor, name: str | None = None
) -> list[tb.Support]:
    """What holds their ends, where they start."""
    supports = []
    for end, node in NODES.items():
        condition, motion = rods[0].condition(end), rods[0].motion(end)
        if condition is EndCondition.FREE:
            continue
        off = nodes[:, node] - beam.nodes[..., node, :]
        held = {"position": "xyz", "rotation": "xyz" if condition is EndCondition.CLAMPED else ""}
        held["displacement"] = None if float(off.abs().max()) == 0 else off
        if motion is not None:
            held["position"] = _held(motion)
            if held["position"] != "xyz":
                off = 0 * off
            motions = [rod.motion(end) for rod in rods]
            held["displacement"] = _table(motions, "displacement", off)
            held["turn"] = _table(motions, "rotation", 0 * off)
        supports.append(tb.Support(node if name is None else (name, node), **held))
    return supports


def _held(motion: Motion) -> str:
    """Axes of the world along which a driven end does not slide."""
    if motion.slides_along is None:
        return "xyz"
    free = [k for k in range(3) if abs(abs(motion.axis[k]) - 1) < 1e-12]
    if not free:
        raise NotImplementedError("an end that slides along no axis of the world")
    return "xyz".replace("xyz"[free[0]], "")


def _table(motions: Sequence[Motion], name: str, first: torch.Tensor) -> Callable:
    """(k, 3) of t: `first` and what motions prescribe, linear between their times."""
    times = torch.tensor(np.stack([m.times for m in motions]))
    values = torch.tensor(np.stack([getattr(m, name) for m in motions]))
    lengths = times.diff(dim=-1)
    slopes = values.diff(dim=-2) / lengths[..., None]

    def value(t: torch.Tensor) -> torch.Tensor:
        gone = torch.minimum((t - times[:, :-1]).clamp(min=0), lengths)
        return first + (gone[..., None] * slopes).sum(-2)

    return value


def _loads(rods: Sequence[Rod], name: str | None = None) -> list[Any]:
    loads = []
    for k, load in enumerate(rods[0].loads):
        node = NODES[load.at] if name is None else (name, NODES[load.at])
        force = torch.tensor([rod.loads[k].force for rod in rods])
        loads.append(tb.PointLoad(node, force=force))
    return loads


def _everywhere(scenario: Scenario) -> list[Any]:
    effects: list[Any] = [tb.MassDamping(_damping(scenario))] if scenario.quasi_static else []
    return effects + ([tb.Gravity(scenario.gravity)] if any(scenario.gravity) else [])


def _damping(scenario: Scenario) -> float:
    return 2 * scenario.slowest_frequency() if scenario.quasi_static else 0.0


# Contact


def _law(scenario: Scenario, rod: Rod, other: Any, tip: bool = False) -> dict[str, float]:
    """Of a rod with an obstacle, or another rod: what is expected to press is its weight, where it
    is hung over something round half of it in tension. Of the round end of one, a ball, in N: as
    much of the rod as stands on its tip before it buckles, two bending lengths.
    """
    g = float(np.linalg.norm(scenario.gravity)) or 1.0
    weight = rod.material.density * rod.area * g
    bend = other.radius if isinstance(other, (Cylinder, Rod)) else math.inf
    press = weight * (1 + rod.length / (2 * bend))
    if tip:
        EI = rod.material.youngs_modulus * rod.second_moment_of_area
        press = weight * 2 * (EI / weight) ** (1 / 3)
    mu = max(rod.friction, getattr(other, "friction", 0.0))
    thick, stiff = (FLAT, STIFF * FALLS) if isinstance(other, Plane) else (LAYER, STIFF)
    layer = thick / (2 if isinstance(other, Rod) else 1)  # of each surface
    law = {
        "thickness": thick * rod.radius,
        "force": stiff * press,
        "damping": DAMPING,
        "radius": rod.radius * (1 - layer * (1 - stiff**-0.5)),  # surfaces meet where that presses
    }
    slip = HOLDS if isinstance(other, Cylinder) else SLIP
    return {**law, "friction": mu, "slip_speed": slip * rod.length} if mu else law


def _obstacles(scenario: Scenario, rod: Rod, name: str | None = None) -> list[tb.Contact]:
    contacts = []
    for it in scenario.obstacles:
        solid = (
            tb.Cylinder(it.center, it.axis, it.radius)
            if isinstance(it, Cylinder)
            else tb.Plane(it.point, it.normal)
        )
        where = (solid,) if name is None else (name, solid)
        law = _law(scenario, rod, it)
        contacts.append(tb.Contact(*where, **law, points=POINTS, push_out=True))
        if isinstance(it, Plane):  # on which a rod may stand
            law = _law(scenario, rod, it, tip=True)
            contacts += [
                tb.Contact(solid, node=k if name is None else (name, k), **law, push_out=True)
                for end, k in NODES.items()
                if rod.condition(end) is EndCondition.FREE
            ]
    return contacts


def _met(scenario: Scenario, moved: list[torch.Tensor]) -> dict[tuple[int, int], int]:
    """Pairs of rods, or of a rod and itself, that may have come within their radii and the
    contact's layer: at which frame first, by as much as nodes move from there to the next one.
    An element is taken for the ball around it.
    """
    met = {}
    middles = [(x[:, 1:] + x[:, :-1]) / 2 for x in moved]
    halves = [x.diff(dim=1).norm(dim=-1) / 2 for x in moved]
    steps = [torch.nn.functional.pad(x.diff(dim=0).norm(dim=-1).amax(-1), (0, 1)) for x in moved]
    for i, j in itertools.combinations_with_replacement(range(len(moved)), 2):
        a, b = scenario.rods[i], scenario.rods[j]
        if i == j and not scenario.self_contact:
            continue
        apart = torch.cdist(middles[i], middles[j]) - halves[i][..., None] - halves[j][:, None]
        if i == j:
            own = torch.arange(apart.shape[-1])
            fewest = neighbour_elements(a.radius, a.length / len(own))
            apart[:, own - own[:, None] <= fewest] = math.inf
        reach = (1 + LAYER) * (a.radius + b.radius) + steps[i] + steps[j] * (i != j)
        near = (apart.amin((-1, -2)) < reach).nonzero()
        if len(near):
            met[i, j] = int(near[0])
    return met


def _components(count: int, met: dict[tuple[int, int], int]) -> list[list[int]]:
    """Rods that have met, directly or by others."""
    groups = [{i} for i in range(count)]
    for i, j in met:
        one, two = (next(g for g in groups if k in g) for k in (i, j))
        if one is not two:
            groups.remove(two)
            one |= two
    return [sorted(g) for g in groups if any(i in g for i, _ in met)]


# Scenes


def _alike(rods: Sequence[Rod]) -> list[list[int]]:
    """Rods of which one batch can be made."""
    groups: dict[Any, list[int]] = {}
    for i, rod in enumerate(rods):
        motions = tuple(m and (len(m.times), m.slides_along) for m in map(rod.motion, End))
        loads = tuple(load.at for load in rod.loads)
        groups.setdefault((rod.start, rod.end, motions, loads, rod.radius), []).append(i)
    return list(groups.values())


def _batch(scenario: Scenario, rods: Sequence[Rod], elements: int) -> tuple[tb.Scene, tb.State]:
    beam, nodes = _beam(rods, elements)
    effects = [*_loads(rods), *_everywhere(scenario), *_obstacles(scenario, rods[0])]
    scene = tb.Scene(beam, effects, supports=_supports(rods, beam, nodes))
    return scene, tb.State.from_nodes(scene, nodes)


def _structure(
    scenario: Scenario, now: dict[int, Motions], met: dict[tuple[int, int], int], t: float
) -> tuple[tb.Scene, tb.State]:
    """Of rods that meet, from where they are at t on: a batch of one."""
    beams, supports, effects = {}, [], _everywhere(scenario)
    for i, (x, *_) in now.items():
        rod, name = scenario.rods[i], f"rod{i}"
        beams[name], nodes = _beam([rod], len(x) - 1, touching=True)
        supports += _supports([rod], beams[name], nodes, name)
        effects += [*_loads([rod], name), *_obstacles(scenario, rod, name)]
    for i, j in sorted(met):
        if i in now:
            law = _law(scenario, scenario.rods[i], scenario.rods[j])
            kind = (
                tb.SelfContact(f"rod{i}", **law)
                if i == j
                else tb.Contact(f"rod{i}", f"rod{j}", **law)
            )
            effects.append(kind)
    scene = tb.Scene(beams, effects, supports=supports)
    x, q, v, spin = (torch.cat(parts)[None] for parts in zip(*now.values(), strict=True))
    return scene, tb.State.from_nodes(scene, x, quat.matrix(q), velocity=v, spin=spin, t=t)


def _directors(x: torch.Tensor, q: torch.Tensor) -> torch.Tensor:
    """(..., N, 3): the section's z axis in the middle of each element, across its chord."""
    d = quat.matrix(quat.half_way(q[..., :-1, :], q[..., 1:, :]))[..., 2]
    along = torch.nn.functional.normalize(x.diff(dim=-2), dim=-1)
    return torch.nn.functional.normalize(d - (d * along).sum(-1, keepdim=True) * along, dim=-1)
