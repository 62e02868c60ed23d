"""First use: seconds until a scene's first step and first gradient, with an empty cache and from
the cache.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator

import torch

from torchbeam import Stepper
from torchbeam.core.measurement import Measured, apart, progress

from ..common_case import SPACES, Case

PART = "first use"


def rows(quick: bool) -> Iterator[Measured]:
    """Each in a process of its own, torch and torchbeam imported."""
    for space in ("plane",) if quick else SPACES:
        with tempfile.TemporaryDirectory() as folder:
            for what in ("cold", "from the cache"):
                seconds_apart = apart(first, space, TORCHBEAM_CACHE=folder)
                for name, seconds in seconds_apart.items():
                    yield Measured.of(
                        PART, f"{what}: {name}", seconds, "s", engine="compiled", space=space
                    )
                progress(f"{space}, {what}: {sum(seconds_apart.values()):.2f} s")


def first(space: str) -> dict[str, float]:
    """Seconds of what is done for the first time; llvmlite is imported by the first step."""
    case = Case.load()
    EI, seconds, last = case.t.new_tensor(1.0, requires_grad=True), {}, time.perf_counter()

    def lap(name: str) -> None:
        nonlocal last
        seconds[name], last = time.perf_counter() - last, time.perf_counter()

    stepper = Stepper(case.scene(8, SPACES[space], EI), 0.005, engine="compiled")
    lap("tracing")
    with torch.no_grad():
        stepper(stepper.rest())
    lap("first step")
    stepper(stepper.rest()).tip.position.sum().backward()
    lap("first gradient")
    return seconds
