"""Gradients: time of the whole gradient of a rollout over that of its forward alone, and the memory
that it takes.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from statistics import median

import torch

import torchbeam as tb
from torchbeam.core.measurement import Measured, apart, progress, timed

from ..common_case import SPACES, Case
from ..peak_memory import peak_memory

PART = "gradients"
STEP, STEPS, OUTPUT = 0.005, 400, 0.02  # s; the tip enters the loss every 20 ms
ELEMENTS = {"3D": 10, "plane": 12}


def rollout(
    space: str,
    batch: int,
    gradient: bool,
    steps: int = STEPS,
    output: float = OUTPUT,
    engine: str = "compiled",
) -> float:
    """Mean of the squared distance of the tip from a point, over a batch of bending stiffnesses;
    with its gradient by these and by the force.
    """
    case = Case.load()
    EI = (
        torch.linspace(0.9, 1.1, batch, dtype=case.t.dtype) if batch > 1 else case.t.new_tensor(1.0)
    )
    force = case.t.new_tensor((0.0, 1.0, 0.0))
    t = torch.arange(0, steps * STEP + STEP / 2, output, dtype=case.t.dtype)
    of = (x.requires_grad_(gradient) for x in (EI, force))
    with torch.set_grad_enabled(gradient):
        scene = case.scene(ELEMENTS[space], SPACES[space], *of)
        solution = tb.simulate(scene, t, step=STEP, engine=engine)
        loss = (solution.tip.position - case.t.new_tensor((0.6, 0.6, 0.0))).square().sum(-1).mean()
        if gradient:
            loss.backward()
    return loss.item()


def rows(quick: bool) -> Iterator[Measured]:
    """Forward, gradient and their ratio by space and batch; memory in 3D."""
    steps, batches, repeats = (40, (1, 32), 2) if quick else (STEPS, (1, 256), 3)
    for space in ("3D",) if quick else ELEMENTS:
        for batch in batches:
            sizes = dict(elements=ELEMENTS[space], step_ms=1e3 * STEP, batch=batch)
            where = dict(engine="compiled", space=space, **sizes)
            runs = [partial(rollout, space, batch, gradient, steps) for gradient in (False, True)]
            forward, whole = timed(runs, repeats)
            yield forward.row(PART, f"forward, {steps} steps", **where)
            yield whole.row(PART, f"gradient, {steps} steps", **where)
            ratios = [b / a for a, b in zip(forward.wall, whole.wall, strict=True)]
            best = min(whole.wall) / min(forward.wall)
            yield Measured(PART, "gradient over forward", best, median(ratios), "", **where)
            progress(f"{space}, batch {batch}: gradient {median(ratios):.2f} times its forward")
    if find_spec("resource") is None:
        progress("memory is not measured: this system does not tell it")
        return
    kinds = (("memory, tip every 20 ms", OUTPUT), ("memory, tip at the end", STEPS * STEP))
    for what, output in kinds[:1] if quick else kinds:
        bytes_of = apart(memory, "3D", batches[-1], output)
        sizes = dict(elements=ELEMENTS["3D"], step_ms=1e3 * STEP, batch=batches[-1])
        where = dict(engine="compiled", space="3D", **sizes)
        yield Measured.of(PART, f"{what}, {STEPS} steps", bytes_of["MB"], "MB", **where)
        progress(f"{what}: {bytes_of['MB']:.0f} MB")


def memory(space: str, batch: int, output: float) -> dict[str, float]:
    """MB that a rollout with gradient takes beside what the process has when its code is
    compiled.
    """
    rollout(space, batch, True, steps=8, output=8 * STEP)
    taken = peak_memory()
    rollout(space, batch, True, output=output)
    return {"MB": taken()}
