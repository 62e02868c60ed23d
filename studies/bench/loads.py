"""Loads of a file: which engine each runs in, and native steps beside eager ones."""

from __future__ import annotations

import importlib.util
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import torch

import torchbeam as tb
from torchbeam.core.measurement import progress
from torchbeam.engine.chain.coverage import why_eager, why_not_traced
from torchbeam.extend.commands import table
from torchbeam.nodal.discretise import discretise

from ..harness import Refused

STEP, NATIVE, EAGER = 5e-3, 40, 4  # s; steps that are timed
REPEATS = 3


class LoadRow(NamedTuple):
    """A load, the engine of its steps, their times in ms, eager over native, and why it is eager
    ("" = it is not).
    """

    name: str
    engine: str
    native_ms: float | str
    eager_ms: float
    ratio: float | str
    reason: str


def of_file(path: Path) -> dict[str, Callable[[], Any]]:
    """`LOADS` of a Python file: name -> function that makes a load. Raises Refused where there
    is none.
    """
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise Refused(f"--loads {path} was given; a Python file is wanted")
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # dataclasses look there
    spec.loader.exec_module(module)
    loads = getattr(module, "LOADS", None)
    if not isinstance(loads, dict):
        raise Refused(
            f"--loads {path} was given; a file with LOADS, functions that make a load by name, "
            "is wanted"
        )
    return loads


def rows(path: Path) -> Iterator[LoadRow]:
    """On a beam of four elements in a plane, pulled at its tip."""
    for name, make in of_file(path).items():
        progress(f"{name} ...")
        section = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=0.3, inertia=1e-4)
        effects = [make(), tb.TipLoad(force=(0.2, 0, 0.8)), tb.MassDamping(0.3)]
        yield _row(name, tb.Scene(tb.Beam.straight(1.0, 4, section), effects, plane="xz"))


@torch.no_grad()
def _row(name: str, scene: tb.Scene) -> LoadRow:
    model = discretise(scene)
    reason = why_eager(model, "midpoint") or why_not_traced(model, "midpoint") or ""
    engines = {"eager": EAGER} if reason else {"compiled": NATIVE, "eager": EAGER}
    best = {}
    for repeat in range(REPEATS + 1):  # the first makes native code
        for engine, steps in engines.items():
            begin = time.process_time()
            tb.simulate(scene, torch.tensor([0.0, STEP * steps]), step=STEP, engine=engine)
            if repeat:
                best[engine] = min(
                    best.get(engine, float("inf")), 1e3 * (time.process_time() - begin) / steps
                )
    native, eager = best.get("compiled", ""), best["eager"]
    ratio = eager / native if native else ""
    return LoadRow(name, "eager" if reason else "native", native, eager, ratio, reason)


def markdown(rows: list[LoadRow]) -> str:
    """A table, and how many are native."""
    lines = []
    for r in rows:
        cells = [x if isinstance(x, str) else f"{x:.3g}" for x in (r.name, r.engine, *r[2:5])]
        lines.append(cells)
    native = f"{sum(row.engine == 'native' for row in rows)} of {len(rows)} are native."
    reasons = [f"- {row.name}: {row.reason}" for row in rows if row.reason]
    head = "load | engine | native, ms a step | eager | eager over native"
    return "\n".join([table(head, lines, words=2), "", native, *reasons])
