"""Convergence: what `converge` found."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from ...core import files
from ...core.summary import aligned
from ...scene.scene import Scene
from .setting import Setting


@dataclass(frozen=True)
class TriedSetting:
    """One setting that was run.

    steps      their number, None in statics
    error      relative difference from the chosen solution after it was corrected by its two finer
               levels: an estimate of the setting's whole error, in which those of mesh and step may
               cancel
    seconds    CPU time, without that of compiling;  iterations: of Newton's method, or None
    chosen     whether it is the one chosen
    """

    setting: Setting
    steps: int | None
    error: float
    seconds: float
    iterations: float | None
    chosen: bool


COLUMNS = "element", "elements", "method", "step", *[f.name for f in fields(TriedSetting)][1:]


@dataclass(frozen=True)
class Convergence:
    """Result of `converge`. Printed, it is a table of the settings that were tried, with notes.

    Attributes:
        solution: solution with these settings, without gradient: a `Solution`, or the result of
            `solve`
        settings: a `Setting`: element, elements, method, step
        code: the settings as Python code
        scene: the scene on the mesh of the settings, differentiable
        options: keywords of `simulate`: `tb.simulate(best.scene, t, **best.options)` is the run
        error: estimated, relative: the sum of mesh_error and step_error
        rtol: the wanted error
        converged: whether the error is at most rtol
        notes: sentences: orders that were not reached, settings that were refused, settings that
            are needed
        table: the settings that were tried, in the order in which they were run
        seconds: CPU time of the search, compiling included

    Examples:
        >>> best = tb.converge(
        ...     scene, None, lambda state: state.tip.position, rtol=0.05, solve=tb.equilibrium
        ... )
        >>> best.mesh_error < 0.05, best.scene.beam.element_count
        (True, 4)
    """

    solution: Any
    settings: Setting
    scene: Scene
    rtol: float
    mesh_error: float
    step_error: float
    notes: tuple[str, ...]
    table: tuple[TriedSetting, ...]
    seconds: float

    @property
    def error(self) -> float:
        return self.mesh_error + self.step_error

    @property
    def converged(self) -> bool:
        return self.error <= self.rtol

    @property
    def options(self) -> dict[str, Any]:
        return self.settings.steps

    @property
    def code(self) -> str:
        """Lines of Python that use the settings."""
        mesh = self.settings.mesh
        head = f"# estimated error {self.error:.2g} (mesh {self.mesh_error:.2g}"
        lines = [
            f"{head}, step {self.step_error:.2g})" if self.options else f"{head})",
            f"scene = tb.remesh(scene, {mesh['elements']}, order={mesh['order']}, "
            f"linked={mesh['linked']})",
        ]
        if self.options:
            options = ", ".join(f"{name}={value!r}" for name, value in self.options.items())
            lines.append(f"solution = tb.simulate(scene, t, {options})")
        return "\n".join(lines)

    def rows(self) -> list[list[Any]]:
        """The table's values, by `COLUMNS`."""
        both = [{**vars(tried), **vars(tried.setting)} for tried in self.table]
        return [[row[name] for name in COLUMNS] for row in both]

    def csv(self, path: Any) -> None:
        """Write the table to a file."""
        files.write(files.file_of("path", path), files.csv_text([COLUMNS, *self.rows()]))

    def __str__(self) -> str:
        head = ("", "element", "elements", "method", "steps", "off by", "CPU ms")
        rows = [
            (
                "->" if tried.chosen else "",
                tried.setting.element,
                str(tried.setting.elements),
                tried.setting.method or "",
                "" if tried.steps is None else str(tried.steps),
                f"{tried.error:.1e}",
                f"{1e3 * tried.seconds:.3g}",
            )
            for tried in sorted(self.table, key=lambda tried: tried.seconds)
        ]
        reached = "" if self.converged else f", more than the {self.rtol:g} that were wanted"
        parts = f" (mesh {self.mesh_error:.1e}, step {self.step_error:.1e})" * bool(self.options)
        said = f"{self.settings}: estimated error {self.error:.1e}{parts}{reached}"
        return "\n".join([said, *self.notes, *aligned([head, *rows])])
