"""Structures beside one beam of as many elements: a tree and a ring of welded beams, fingers,
gradients, equilibria; each a ratio of CPU times that are taken in turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from statistics import median

import torch

import torchbeam as tb
from torchbeam.core.measurement import Measured, progress, timed

PART = "structures"
BEAMS, ELEMENTS, STEP, STEPS = 8, 8, 1e-3, 200
WEIGHT = (0.3, 0.5, -9.81)  # m/s^2
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def section() -> tb.Section:
    numbers = dict(EA=4e4, GA=1.4835e4, GJ=0.769, mass=0.2, inertia=5e-6)
    one = torch.ones((), dtype=torch.float64)
    return tb.Section.from_stiffness(EI=one, **{name: one * x for name, x in numbers.items()})


def welded(roots: list[int | None], parts: dict[str, tb.Beam], *more: tb.Weld) -> tb.Scene:
    """Each beam on the tip of another (None = clamped)."""
    joints = [
        tb.Weld((f"{root}", -1), (f"{k}", 0)) for k, root in enumerate(roots) if root is not None
    ]
    supports = [tb.Support((f"{k}", 0)) for k, root in enumerate(roots) if root is None]
    return tb.Scene(parts, [tb.Gravity(WEIGHT)], joints=[*joints, *more], supports=supports)


def beam(count: int = BEAMS * ELEMENTS) -> tb.Scene:
    """One, clamped, of the same elements as the others."""
    return tb.Scene(tb.Beam.straight(count / 64, count, section()), [tb.Gravity(WEIGHT)])


def tree() -> tb.Scene:
    """A binary one, of beams at right angles."""
    roots, own = [None, *((k - 1) // 2 for k in range(1, BEAMS))], 1 / BEAMS
    tips, parts = [], {}
    for k, root in enumerate(roots):
        direction = torch.tensor(AXES[k % 3], dtype=torch.float64)
        start = torch.zeros_like(direction) if root is None else tips[root]
        parts[f"{k}"] = tb.Beam.straight(own, ELEMENTS, section(), root=start, direction=direction)
        tips.append(start + own * direction)
    return welded(roots, parts)


def ring() -> tb.Scene:
    """A closed polygon, clamped at a corner."""
    angle, own, parts = 2 * math.pi / BEAMS, 1 / BEAMS, {}
    place = torch.zeros(3, dtype=torch.float64)
    for k in range(BEAMS):
        direction = torch.tensor(
            (math.cos(k * angle), 0.0, math.sin(k * angle)), dtype=torch.float64
        )
        side = tb.Beam.straight(
            own, ELEMENTS, section(), root=place, direction=direction, up=(0, 1, 0)
        )
        parts[f"{k}"], place = side, place + own * direction
    last = tb.Weld((f"{BEAMS - 1}", -1), ("0", 0))
    return welded([None, *range(BEAMS - 1)], parts, last)


def fingers() -> tb.Scene:
    """Beside each other, each clamped."""
    parts = {
        f"{k}": tb.Beam.straight(1 / BEAMS, ELEMENTS, section(), root=(0.0, 0.1 * k, 0.0))
        for k in range(BEAMS)
    }
    return welded([None] * BEAMS, parts)


def loop() -> tb.Scene:
    """Two beams, welded and hinged to each other, on a third: what operations are counted of."""
    ends = ((0.0, 0, 0), (1.0, 0, 0)), ((0.0, 0, 0), (0, 0, 1.0)), ((1.0, 0, 0), (0, 0, 1.0))
    parts = {
        name: tb.Beam.straight(1.0, 3, section(), root=root, direction=direction)
        for name, (root, direction) in zip("abc", ends, strict=True)
    }
    joints = [tb.Weld(("a", 0), ("b", 0)), tb.Weld(("a", -1), ("c", 0))]
    joints.append(tb.Hinge(("b", 2), ("c", 2), axis=(0, 1, 0), at=(0.5, 0, 0.5)))
    return tb.Scene(parts, [tb.Gravity(WEIGHT)], joints=joints, supports=[tb.Support(("a", 0))])


def rows(quick: bool) -> Iterator[Measured]:
    """Ratios by structure."""
    steps, repeats = (20, 2) if quick else (STEPS, 8)
    one, branches = _stepping(beam(), steps), _stepping(tree(), steps)
    finger = _stepping(beam(ELEMENTS), steps)

    def singles() -> None:
        for _ in range(BEAMS):
            finger()

    pairs = {
        "tree of 8 beams of 8 elements / one of 64": (branches, one),
        "ring of 8 beams of 8 elements / one of 64": (_stepping(ring(), steps), one),
        "8 fingers / 8 runs of one": (_stepping(fingers(), steps), singles),
        "gradient / forward, tree": (_stepping(tree(), steps, True), branches),
        "gradient / forward, one beam": (_stepping(beam(), steps, True), one),
        "equilibrium, tree / one of 64": (_resting(tree()), _resting(beam())),
    }
    for what, pair in pairs.items():
        a, b = timed(pair, repeats)
        ratios = [x / y for x, y in zip(a.cpu, b.cpu, strict=True)]
        best = min(a.cpu) / min(b.cpu)
        where = dict(engine="compiled", space="3D", step_ms=1e3 * STEP)
        yield Measured(PART, what, best, median(ratios), "", **where)
        progress(f"{what}: {best:.2f}")


def _stepping(scene: tb.Scene, steps: int, gradient: bool = False) -> Callable[[], None]:
    """A rollout; with the gradient by its start."""
    stepper = tb.Stepper(scene, STEP, engine="compiled")
    start = stepper.rest()

    def run() -> None:
        begin = start.map(lambda x: x.clone())
        velocity = begin.velocity.requires_grad_(gradient)
        states = tb.rollout(stepper, begin, steps)
        if gradient:
            torch.autograd.grad(states.position[-1].sum(), velocity)

    return run


def _resting(scene: tb.Scene) -> Callable[[], None]:
    return lambda: tb.equilibrium(scene, engine="compiled") and None
