"""Gradients of a rollout by every way: error, time and memory over the number of parameters and of
steps.
"""

from __future__ import annotations

import subprocess
import time
from argparse import ArgumentTypeError, Namespace
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.core.measurement import apart, progress
from torchbeam.extend.commands import table, threads
from torchbeam.plot.canvas import grid, save
from torchbeam.solvers.jacobian import difference, forward

from .harness import Report, Study
from .peak_memory import peak_memory

NAME = "gradients"
ELEMENTS, STEP, OUTPUTS = 8, 1e-3, 10  # s; instants at which the tip enters the loss
FINE, TIGHT = 1e-4, 1e-7  # step of differences; tolerance of explicit steps
PARAMETERS, STEPS = (1, 10, 100, 1000), (10, 100, 1000, 10_000)
USUAL = 10, 100  # parameters where steps grow, steps where parameters do
BUDGET = 60.0  # s of a row, warm-up and a new process included
REPEATS = 3
LITTLE = 0.1  # MB, what less is drawn as
FORWARD = {"forward run, eager": "eager", "forward run, compiled": "compiled"}
ADJOINT = {
    "adjoint, eager": ("eager", False),
    "adjoint, eager, checkpointed": ("eager", True),
    "adjoint, compiled": ("compiled", False),
    "adjoint, compiled, checkpointed": ("compiled", True),
}
EXPLICIT = {"explicit form, odeint_adjoint": True, "explicit form, through its steps": False}
WAYS = (*FORWARD, "forward mode, eager", *ADJOINT, "differences, compiled", *EXPLICIT)
# the first that there is
REFERENCES = ("adjoint, eager", "adjoint, eager, checkpointed", "adjoint, compiled")
ABOUT = (
    "A planar cantilever of 8 elements under a sudden force on its tip, damped, in steps of 1 ms. "
    "The loss is the mean squared distance of the tip from a point at 10 instants. A fixed matrix "
    "mixes p parameters into the 8 bending stiffnesses and the force: the beam is the same for "
    "any p. Forward mode: p directions as one batch. Differences: central, steps of 1e-4, a batch "
    "of 2 p + 1. The section is soft along and across (EA = GA = 300 N), or explicit steps would "
    "be a hundred times as many."
)
LEGEND = (
    "CPU: seconds on one thread, best of up to 3 after a short run to warm up. Over: ratio to the "
    "compiled forward run. Memory: the peak above the warm process. Error: largest entry of the "
    "difference from the gradient of the discrete equations, over the largest entry. This gradient "
    "is the eager adjoint's, or the compiled one's where that took too long. For odeint_adjoint "
    "it is the gradient through the same explicit steps (dopri5, 1e-7), of which odeint_adjoint "
    "is not the derivative. Each row has a process of its own, stopped after {budget:g} s; larger "
    "problems of that way are then left out."
)


class GradientCost(NamedTuple):
    """One way on one problem; None where the budget was too small, and `status` says so."""

    way: str
    parameters: int
    steps: int
    seconds: float | None
    over: float | None
    memory: float | None
    error: float | None
    status: str


def loss(theta: Tensor, steps: int, **options: Any) -> Tensor:
    """(n,) for parameters (n, p)."""
    p = theta.shape[-1]
    mix = (
        torch.cos(
            torch.arange(1, p + 1).to(theta)[:, None] * torch.arange(1, ELEMENTS + 2).to(theta)
        )
        / p**0.5
    )
    change = 1 + 0.1 * theta @ mix
    soft = dict(EA=300.0, GA=300.0, GJ=1.0, mass=0.2, inertia=1e-3)
    section = [tb.Section.from_stiffness(EI=x, **soft) for x in change[:, :-1].unbind(-1)]
    force = 0.5 * change[:, -1:] * theta.new_tensor((0.0, 0.0, 1.0))
    scene = tb.Scene(
        tb.Beam.straight(theta.new_tensor(1.0), ELEMENTS, section),
        [tb.TipLoad(force=force), tb.Damping(1e-3)],
        plane="xz",
    )
    t = STEP * torch.linspace(0, steps, min(OUTPUTS, steps) + 1, dtype=theta.dtype).round()
    solution = tb.simulate(scene, t, **options)
    if (solution.status != 0).any():
        raise RuntimeError("the rollout failed")
    return (solution.tip.position - theta.new_tensor((0.9, 0.0, 0.2))).square().sum(-1).mean(0)


def gradient(mode: str, parameters: int, steps: int) -> Tensor:
    """(p,) at zero, by one of WAYS; of a forward run the loss (1,)."""
    theta = torch.zeros(1, parameters, dtype=torch.float64)
    implicit = partial(loss, steps=steps, method="midpoint", step=STEP)
    with torch.no_grad():
        if mode in FORWARD:
            return implicit(theta, engine=FORWARD[mode])
        if mode == "differences, compiled":
            return difference(
                lambda x: implicit(x, engine="compiled")[:, None],
                theta,
                torch.full_like(theta, FINE),
            )[1][0, 0]
    if mode == "forward mode, eager":
        return forward(lambda x: implicit(x, engine="eager")[:, None], theta)[1][0, 0].detach()
    theta.requires_grad_()
    if mode in ADJOINT:
        engine, checkpoint = ADJOINT[mode]
        implicit(theta, engine=engine, checkpoint=checkpoint).sum().backward()
    else:
        loss(
            theta, steps, method="dopri5", rtol=TIGHT, atol=TIGHT, adjoint=EXPLICIT[mode]
        ).sum().backward()
    return theta.grad[0]


def measured(mode: str, parameters: int, steps: int, repeats: int, budget: float) -> dict[str, Any]:
    """CPU seconds (the least), MB and the gradient, after a short run of the same way."""
    with threads(1):
        begun = time.perf_counter()
        gradient(mode, parameters, min(steps, 4))
        times: list[float] = []
        taken = peak_memory()
        while len(times) < repeats and (
            not times or time.perf_counter() - begun + 1.5 * times[-1] < 0.7 * budget
        ):
            start = time.process_time()
            cost = gradient(mode, parameters, steps)
            times.append(time.process_time() - start)
    return {"seconds": min(times), "MB": taken(), "gradient": cost.tolist()}


def cells(quick: bool) -> list[tuple[int, int]]:
    """Parameters and steps of the problems, from small to large."""
    if quick:
        return [(1, 10), (4, 10)]
    return [(p, USUAL[1]) for p in PARAMETERS] + [(USUAL[0], n) for n in STEPS if n != USUAL[1]]


def rows(quick: bool, budget: float) -> Iterator[GradientCost]:
    """Every way on every problem, the ways side by side."""
    known: dict[tuple[int, int], dict[str, dict[str, Any]]] = {}
    said: dict[str, list[tuple[int, int]]] = {way: [] for way in WAYS}
    for cell in cells(quick):
        measurements = known.setdefault(cell, {})
        status = {}
        for way in WAYS:
            if any(p <= cell[0] and n <= cell[1] for p, n in said[way]):
                status[way] = "left out"
                continue
            try:
                measurements[way] = apart(
                    measured, way, *cell, 1 if quick else REPEATS, budget, limit=budget
                )
            except subprocess.TimeoutExpired:
                status[way] = f"over {budget:g} s"
            except RuntimeError as error:
                status[way] = f"failed: {str(error).strip().splitlines()[-1]}"
            if way not in measurements:
                said[way].append(cell)
            report = (
                status[way]
                if way in status
                else f"{measurements[way]['seconds']:.3g} CPU s, {measurements[way]['MB']:.0f} MB"
            )
            progress(f"{cell[0]:,} parameters, {cell[1]:,} steps, {way}: {report}")
        yield from (_row(way, cell, measurements, status) for way in WAYS)


def _row(
    mode: str,
    cell: tuple[int, int],
    measurements: dict[str, dict[str, Any]],
    status: dict[str, str],
) -> GradientCost:
    if mode not in measurements:
        return GradientCost(mode, *cell, None, None, None, None, status[mode])
    base = measurements.get("forward run, compiled")
    own = ("explicit form, through its steps",) if mode in EXPLICIT else REFERENCES
    reference = next((name for name in own if name in measurements), None)
    error = None
    if reference is not None and mode not in (*FORWARD, reference):
        exact = torch.tensor(measurements[reference]["gradient"], dtype=torch.float64)
        error = (
            (torch.tensor(measurements[mode]["gradient"], dtype=torch.float64) - exact).abs().max()
            / exact.abs().max()
        ).item()
    seconds = measurements[mode]["seconds"]
    over = None if base is None else seconds / base["seconds"]
    return GradientCost(mode, *cell, seconds, over, measurements[mode]["MB"], error, "")


def study(options: Namespace) -> Report:
    measurements = list(rows(options.quick, options.budget))
    return Report(
        [ABOUT, markdown(measurements), LEGEND.format(budget=options.budget)],
        measurements,
        {"budget": options.budget, "quick": options.quick},
        picture=lambda folder: picture(measurements, folder / f"{NAME}.png"),
    )


def _budget(text: str) -> float:
    if not float(text) > 0:
        raise ArgumentTypeError(f"{text} was given; a positive number of seconds is wanted")
    return float(text)


def _wanted(options: Namespace) -> str | None:
    if find_spec("llvmlite") is None or find_spec("resource") is None:
        return "llvmlite, which comes with torchbeam, and a system that tells memory are wanted"
    return None


def markdown(rows: list[GradientCost]) -> str:
    """A line for each way and problem."""

    def shown(value: float | None, form: str) -> str:
        return "" if value is None else format(value, form)

    lines = (
        f"{r.way} | {r.parameters:,} | {r.steps:,} | {r.status or shown(r.seconds, '.3g')} | "
        f"{shown(r.over, '.3g')} | {shown(r.memory, '.0f')} | {shown(r.error, '.1e')}"
        for r in rows
    )
    return table("way | parameters | steps | CPU s | over | MB | error", lines, words=1)


def picture(rows: list[GradientCost], path: Path) -> None:
    """Time and memory over parameters, and over steps. Raises ImportError without matplotlib."""
    steps, parameters = {r.steps for r in rows}, {r.parameters for r in rows}
    usual = (
        USUAL[0] if USUAL[0] in parameters else max(parameters),
        USUAL[1] if USUAL[1] in steps else max(steps),
    )
    places = grid(2, 2, (9.0, 6.4))
    for one, other in (places[:2], places[2:]):
        other.sharey(one)
    for k, (over, held) in enumerate((("parameters", "steps"), ("steps", "parameters"))):
        time_, memory = places[k], places[2 + k]
        for way in WAYS:
            line = sorted(
                (getattr(r, over), r.seconds, r.memory)
                for r in rows
                if r.way == way and getattr(r, held) == usual[1 - k] and r.seconds is not None
            )
            if line:
                x, seconds, taken = zip(*line, strict=True)
                style = dict(
                    label=way, ls="--" if way in FORWARD else "-", marker="o", ms=3,
                    color=f"C{WAYS.index(way)}",
                )  # fmt: skip
                time_.loglog(x, seconds, **style)
                memory.loglog(x, [max(m, LITTLE) for m in taken], **style)
        time_.set(title=f"{usual[1 - k]:,} {held}", ylabel="CPU s")
        memory.set(xlabel=over, ylabel="memory / MB")
    for axis in places:
        axis.grid(True, which="major", alpha=0.3)
    labels = places[0].get_legend_handles_labels()
    places[0].figure.legend(*labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    save(places[0], path)


main = Study(
    NAME,
    "Gradients by every way: error, time and memory over parameters and steps.",
    "Gradients of a rollout: forward mode, discrete adjoint (eager, compiled, checkpointed), "
    "odeint_adjoint of the explicit form, and differences, for 1 to 1,000 parameters and 10 to "
    "10,000 steps; with matplotlib a picture.",
    study,
    quick="two small problems",
    options={
        "--budget": dict(
            type=_budget, default=BUDGET, help="seconds a row may take (default: %(default)g)"
        )
    },
    check=_wanted,
    packages=("llvmlite",),
)
