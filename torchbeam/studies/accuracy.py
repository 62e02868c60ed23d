"""Accuracy against CPU time: the common dynamic case over mesh, step and batch, in 3D and in its plane."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..analysis.trials import repeated, seconds
from ..cli import study, threads
from ..core.files import written
from ..core.results import measured_on, sentence, table, write
from ..core.validation import as_tensor
from ..dynamics.simulate import simulate
from ..scene.beam import Beam
from ..scene.effects import TipLoad
from ..scene.scene import Scene
from ..scene.section import Section
from ..state.solution import Solution


class Case(NamedTuple):
    """The common dynamic case: a clamped beam along x, a dead transverse force of 1 N on its tip, suddenly at t = 0.

    t (time,) s, tip (time, 3) m: converged in space and time by two independent codes; not exact below 2e-4 relative.
    """

    t: Tensor
    tip: Tensor

    @classmethod
    def load(cls, dtype: torch.dtype = torch.float64) -> Case:
        text = resources.files("torchbeam").joinpath("data/dynamic_step_load.json").read_text()
        data = json.loads(text)
        return cls(torch.tensor(data["t"], dtype=dtype), torch.tensor(data["tip"], dtype=dtype))

    def scene(self, elements: int, plane: str | None = None, EI: Tensor | float = 1.0, force: Any = (0.0, 1.0, 0.0),
              element: str = "order 1") -> Scene:
        """element: one of `KINDS`."""
        number = self.t.new_tensor
        section = Section.from_stiffness(EA=number(4e4), GA=number(1.4835e4), GJ=number(0.769),
                                         EI=as_tensor(EI, self.t.dtype), mass=number(0.2), inertia=number(5e-6))
        beam = Beam.straight(number(1.0), elements, section, order=2 if element == "order 2" else 1)
        return Scene(beam.linked() if element == "linked" else beam, [TipLoad(force=force)], plane=plane)

    def error(self, solution: Solution) -> float:
        """RMS |tip - reference| / RMS |reference - reference(0)| at the solution's instants, which are the reference's."""
        at = torch.searchsorted(self.t, solution.t - 1e-9)
        tip = solution.tip.position.detach()
        tip = tip.reshape(len(tip), -1, 3)[:, 0]
        reference = self.tip[at]
        return ((tip - reference).square().sum(-1).mean() / (reference - self.tip[0]).square().sum(-1).mean()).sqrt().item()


class Row(NamedTuple):
    space: str
    elements: int
    step_ms: float
    batch: int
    error: float
    cpu_s: float
    rate: float
    iterations: float


SPACES = {"3D": None, "plane": "xy"}
KINDS = ("order 1", "linked", "order 2")  # of elements; linked: of order 1, by `Beam.linked`
FIELDS = ("space", "elements", "step, ms", "batch", "relative RMS error", "CPU s for 2 s", "simulated s per CPU s",
          "Newton iterations")


def motion(case: Case, space: str, elements: int, step: float, every: int | None = None, element: str = KINDS[0],
           **options: Any) -> Solution:
    """The whole 2 s, at batch 1; every: how many of the reference's instants lie between two of the solution's."""
    with torch.no_grad():
        t = case.t[::every or max(1, round(step / 0.01))]
        return simulate(case.scene(elements, SPACES[space], element=element), t, step=step, **options)


def measure(case: Case, whole: Solution, space: str, elements: int, step: float, batch: int, duration: float,
            repeats: int) -> Row:
    """Best of `repeats` after one warm-up, for `duration` from the middle of the whole motion, whose error is taken."""
    scene = case.scene(elements, SPACES[space])
    with torch.no_grad():
        start = repeated(whole.state[len(whole.t) // 2], batch)  # in motion at t = 1 s
        t = torch.linspace(0, duration, 2, dtype=case.t.dtype)

        def run() -> Solution:
            return simulate(scene, t, initial=start, step=step)

        iterations = run().stats.iterations.double().mean().item()
        (best,) = seconds([run], repeats)
    return Row(space, elements, 1e3 * step, batch, case.error(whole), best * 2 / duration, batch * duration / best,
               iterations)


def main(argv: Sequence[str] | None = None) -> int:
    """Error against CPU time on the common dynamic case."""
    given, out = study(argv, "accuracy", (
        "Error against CPU time on the common dynamic case (cantilever, sudden tip load, 2 s), one thread, float64; with "
        "matplotlib also as a picture, accuracy.png."), quick="two meshes, one step, short timing")
    with threads(1):
        rows, heading = list(_rows(given.quick)), measured_on()
    text = f"{_markdown(rows)}\n\n{sentence(heading)}"
    print(text)
    write(out, "accuracy", text, {**heading, "rows": [r._asdict() for r in rows]}, FIELDS, rows)
    _picture(rows, out / "accuracy.png")
    return 0


def _rows(quick: bool):
    case = Case.load()
    elements, steps = ((8, 16), (0.01,)) if quick else ((4, 8, 16, 32), (0.0025, 0.005, 0.01, 0.02))
    whole = {of: motion(case, *of) for of in product(SPACES, elements, steps)}
    for space, batch, N, step in product(SPACES, (1, 256), elements, steps):
        duration = step * (4 if quick or batch > 1 else 40)
        row = measure(case, whole[space, N, step], space, N, step, batch, duration, 1 if quick else 3)
        print(f"{space}, N = {N:2d}, step {1e3 * step:4.1f} ms, batch {batch:3d}: {100 * row.error:6.3f} %", file=sys.stderr)
        yield row


def _markdown(rows: list[Row]) -> str:
    """One line a mesh and step; the plane has the error of 3D."""
    found = {(r.space, r.batch, r.elements, r.step_ms): r for r in rows}
    small, large = sorted({r.batch for r in rows})
    heads = ("elements", "step, ms", "relative RMS error", f"3D, batch {small}: CPU s for 2 s", "plane",
             f"3D, batch {large}: simulated s per CPU s", "plane", "Newton iterations")
    lines = []
    for N, step in dict.fromkeys((r.elements, r.step_ms) for r in rows):
        one, many = ([found[space, batch, N, step] for space in SPACES] for batch in (small, large))
        lines.append((f"{N}", f"{step:g}", f"{100 * one[0].error:.2f} %", f"{one[0].cpu_s:.2f}", f"{one[1].cpu_s:.2f}",
                      f"{many[0].rate:.1f}", f"{many[1].rate:.1f}", f"{one[0].iterations:.1f}"))
    return table(heads, lines, words=0)


def _picture(rows: list[Row], path: Path) -> None:
    try:
        import matplotlib
    except ImportError:
        print("matplotlib is not installed (extra 'plot'): no picture", file=sys.stderr)
        return
    matplotlib.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    panels = sorted({(r.batch, r.space) for r in rows})
    size = 3.6 * len(panels), 3.6
    figure, axes = plt.subplots(1, len(panels), figsize=size, sharey=True, squeeze=False, layout="constrained")
    for axis, (batch, space) in zip(axes[0], panels, strict=True):
        for N in sorted({r.elements for r in rows}):
            line = sorted((r.cpu_s / batch, 100 * r.error) for r in rows if (r.batch, r.space, r.elements) == (batch, space, N))
            axis.loglog(*zip(*line, strict=True), "o-", label=f"{N} elements")
        axis.set(title=f"batch {batch}, {space}", xlabel="CPU s for one sample's 2 s")
        for ticks in (axis.xaxis, axis.yaxis):
            ticks.set_major_locator(LogLocator(subs=(1, 2, 5)))
            ticks.set_major_formatter(StrMethodFormatter("{x:g}"))
            ticks.set_minor_formatter(NullFormatter())
        axis.grid(True, which="both", alpha=0.3)
    axes[0][0].set_ylabel("relative RMS error of the tip, %")
    axes[0][0].legend()
    with written(path) as part:
        figure.savefig(part, dpi=150, format="png")
    plt.close(figure)
