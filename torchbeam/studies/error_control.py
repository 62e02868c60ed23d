"""Error control: the true error of adaptive steps beside the tolerance, over random scenes, and what they cost."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from ..cli import study, threads
from ..core.results import measured_on, sentence, write
from ..core.results import table as markdown_table
from ..dynamics.simulate import simulate
from ..scene import effects as fx
from ..scene.beam import Beam
from ..scene.scene import Frame, RootMotion, Scene
from ..scene.section import Section
from ..scene.supports import Support
from ..state.solution import Solution

SAMPLES = 9  # of a family
OUTPUTS = 25  # instants
NEAR = 0.03  # of the tolerance: two references that differ by less are one
UNDAMPED = "sudden", "weight, plane"  # whose references are dear
FINEST = 2**17  # steps of a reference, at most
ABOUT = (
    "{scenes} random soft rods in {families} families ({elements} elements, length 0.3 to 0.8 m, first period about 2 s, 0.5 to 3 "
    "s of motion, {outputs} instants), rtol from 1e-2 to 1e-5 at random, each sample its own. Error: largest distance of a node "
    "over all instants from a reference (equal steps of the midpoint method, halved until what they extrapolate to stands still to "
    "3 % of the tolerance), over the tolerance. Work: implicit steps made, all trials and runs included. Equal steps: how many of "
    "them have the same tolerance as their error, found by halving and told between by the second order: what a user cannot know "
    "beforehand."
)


@dataclass(frozen=True)
class Row:
    """One sample: error and estimate in tolerances; work: steps made in all; equal: equal steps whose error is the tolerance
    (nan: not measured).
    """

    family: str
    sample: int
    rtol: float
    error: float
    estimate: float
    steps: int
    level: int
    rejected: int
    work: int
    equal: float
    status: int


class Draw:
    """Random numbers, one for each sample."""

    def __init__(self, seed: int, samples: int) -> None:
        self.random, self.samples = torch.Generator().manual_seed(seed), samples

    def __call__(self, low: float, high: float, *shape: int) -> Tensor:
        """Evenly between two."""
        return low + (high - low) * torch.rand(self.samples, *shape, generator=self.random, dtype=torch.float64)

    def log(self, low: float, high: float) -> Tensor:
        """Evenly between the logarithms of two."""
        return self(math.log(low), math.log(high)).exp()

    def vector(self, size: Tensor) -> Tensor:
        """(..., 3) of a length, to any side."""
        x = self(-1.0, 1.0, 3)
        return size[:, None] * x / torch.linalg.vector_norm(x, dim=-1, keepdim=True)


def rod(draw: Draw, elements: int) -> tuple[Beam, Tensor]:
    """A soft rod, and the force EI/L^2 that bends it much."""
    L, EI, mass = draw(0.3, 0.8), draw.log(0.007, 0.06), draw(0.15, 0.6)
    section = Section.from_stiffness(EA=1e4 * EI, GA=4e3 * EI, GJ=draw(0.5, 1.0) * EI, EI=EI, mass=mass,
                                     inertia=mass * draw.log(3e-5, 3e-3))
    return Beam.straight(L, elements, section), EI / L**2


def families(elements: int) -> dict[str, Callable[[Draw], Scene]]:
    """Name -> scenes of random values."""
    def made(*effects: Callable[[Draw, Tensor], Any], **options: Any) -> Callable[[Draw], Scene]:
        def scene(draw: Draw) -> Scene:
            beam, force = rod(draw, elements)
            more = {name: value(draw) if callable(value) else value for name, value in options.items()}
            return Scene(beam, [effect(draw, force) for effect in effects], **more)
        return scene

    def push(low: float, high: float, **more: Any) -> Callable[[Draw, Tensor], Any]:
        return lambda draw, force: fx.TipLoad(force=draw.vector(draw(low, high) * force), **more)

    def damping(draw: Draw, force: Tensor) -> Any:
        return fx.Damping(draw.log(1e-3, 5e-2))

    def weight(draw: Draw, force: Tensor) -> Any:
        return fx.Gravity((0.0, 0.0, -9.81))

    def shaking(draw: Draw, force: Tensor) -> Any:
        size, rate = draw.vector(draw(0.3, 1.5) * force), draw(3.0, 25.0)
        return fx.TipLoad(force=lambda t: size * torch.sin(rate * t)[..., None])

    def kick(draw: Draw, force: Tensor) -> Any:
        size, at, width = draw.vector(draw(2.0, 8.0) * force), draw(0.2, 0.6), draw.log(0.005, 0.05)
        return fx.TipLoad(force=lambda t: size * torch.exp(-((t - at) / width).square())[..., None])

    def turning(draw: Draw) -> Frame:
        rate = draw(1.0, 6.0)
        return Frame(angular_velocity=lambda t: torch.stack((0 * rate, 0 * rate, rate * torch.tanh(t) ** 2), -1))

    def shaken(draw: Draw) -> RootMotion:
        size, rate = draw(0.01, 0.05), draw(3.0, 15.0)
        return RootMotion(displacement=lambda t: torch.stack((0 * size, 0 * size, size * torch.sin(rate * t) ** 2), -1))

    return {
        "sudden": made(push(0.3, 2.0)),
        "sudden, damped": made(push(0.3, 3.0), damping),
        "weight": made(weight, damping),
        "weight, plane": made(weight, plane="xz"),
        "follower": made(push(0.5, 4.0, follower=True), damping),
        "shaking": made(shaking, damping),
        "kick": made(kick, damping),
        "turning": made(damping, weight, frame=turning),
        "shaken root": made(weight, damping, root=shaken),
        "pendulum": made(weight, damping, lambda draw, force: fx.PointMass(draw(0.01, 0.1)),
                         supports=[Support(0, "xyz", "xz")]),
        "drag": made(push(0.5, 3.0), damping, lambda draw, force: fx.Drag(1000.0, draw(0.002, 0.01), added_mass=1.0)),
        "free": made(push(0.1, 1.0, follower=True), damping, lambda draw, force: fx.MassDamping(draw(0.1, 1.0)),
                     supports=[Support(0, "", "")]),
    }


def reference(scene: Scene, t: Tensor, tolerance: Tensor, steps: int = 512) -> tuple[Tensor, list[tuple[int, Tensor]]]:
    """Positions of the nodes (time, samples, nodes, 3) to NEAR of the tolerance m (samples), and those of the runs by so many
    equal steps that led there.
    """
    runs: list[tuple[int, Tensor]] = []
    best = before = None
    while steps <= FINEST:
        runs.append((steps, simulate(scene, t, step=(t[-1] - t[0]).item() / steps).nodes))
        if len(runs) > 1:
            best = runs[-1][1] + (runs[-1][1] - runs[-2][1]) / 3
            if before is not None and (distance(best, before) < NEAR * tolerance).all():
                return best, runs
            before = best
        steps *= 2
    raise RuntimeError(f"no reference to {NEAR:g} of the tolerance by {FINEST} equal steps")


def distance(a: Tensor, b: Tensor) -> Tensor:
    """Largest distance of nodes (samples,) over all instants."""
    return torch.linalg.vector_norm(a - b, dim=-1).amax(-1).amax(0)


def work(sol: Solution) -> Tensor:
    """Implicit steps that each sample made: three a trial of the control, and all runs."""
    counts = (sol.stats.lengths > 0).sum(0)
    return 3 * (counts + sol.stats.rejected) + counts * (2 ** (sol.stats.level + 1) - 1)


def equal_steps(runs: list[tuple[int, Tensor]], best: Tensor, tolerance: Tensor, simulated: Callable[[int], Tensor]) -> Tensor:
    """Number of equal steps (samples,) whose error is the tolerance: between two measured ones by the second order."""
    found = torch.full_like(tolerance, torch.nan)
    runs = sorted([*((k, simulated(k)) for k in (8, 16, 32, 64, 128, 256)), *runs], key=lambda run: run[0])
    for steps, nodes in reversed(runs):
        error = distance(nodes, best)
        within = error <= tolerance
        found = torch.where(within & ((found == 2 * steps) | found.isnan()), steps, found)
        last = (~within) & (found == 2 * steps)
        found = torch.where(last, steps * (error / tolerance).sqrt().clamp(max=2.0), found)
    return found


def measure(seed: int, samples: int, elements: int, names: Sequence[str] | None = None) -> list[Row]:
    """Rows of all samples."""
    rows = []
    for k, (name, make) in enumerate(families(elements).items()):
        if names is not None and name not in names:
            continue
        draw = Draw(100 * seed + k, samples)
        scene = make(draw)
        undamped = name in UNDAMPED
        t = torch.linspace(0, float(draw(0.5, 1.0 if undamped else 3.0)[0]), OUTPUTS, dtype=torch.float64)
        rtol = draw.log(1e-4 if undamped else 1e-5, 1e-2)
        rows += _family(name, scene, t, rtol)
    return rows


def _family(name: str, scene: Scene, t: Tensor, rtol: Tensor) -> list[Row]:
    tolerance = rtol * scene.beam.length.sum(-1)
    best, runs = reference(scene, t, tolerance)
    sol = simulate(scene, t, rtol=rtol)
    error, done = distance(sol.nodes, best) / tolerance, work(sol)
    equal = equal_steps(runs, best, tolerance, lambda k: simulate(scene, t, step=(t[-1] - t[0]).item() / k).nodes)
    stats, counts = sol.stats, (sol.stats.lengths > 0).sum(0)
    columns = rtol, error, stats.error / tolerance, counts, stats.level, stats.rejected, done, equal, sol.status
    return [Row(name, i, *values) for i, values in enumerate(zip(*(x.tolist() for x in columns), strict=True))]
