"""Animations: a motion as a GIF or an MP4 file."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, tolerance
from ..core.files import file_of, folder, written
from ..core.validation import refusal
from ..scene.scene import Scene
from ..state.solution import Solution
from ..state.state import State
from .axis import axis_curves, nodes_of, rows_of
from .canvas import Axes, matplotlib_wanted, numbers
from .limits import framed, prepared
from .shapes import TRIAD
from .solid_picture import SolidPicture

CLOCK: dict[str, Any] = dict(fontsize=9, loc="left", family="monospace")


def animate(
    what: Any,
    path: str | Path,
    ax: Axes | None = None,
    *,
    plane: str | None = None,
    scene: Scene | None = None,
    fps: float = 25.0,
    speed: float = 1.0,
    trail: bool = True,
    frames: bool = False,
    beside: Callable[[int], object] | None = None,
    dpi: int = 100,
) -> Path:
    """Write an animation of a motion to a file. Returns the path of the file.

    Args:
        what: `Solution` with any batch axes, or a `State` whose first batch axis is the film's
            time, such as equilibria under a growing load
        path: ends in .gif (Pillow) or .mp4 (by an ffmpeg program, or the package imageio-ffmpeg)
        ax: axes to draw on. Their contents and the limits that were set stay. None = new axes
        plane: as in `shape`;  frames: with the section axes of the tip;  trail: the path of the tip
        scene: as in `shape`: solids are drawn in their size
        fps: 1/s, pictures a second. A picture of a solution shows the output instant nearest to its
            time, so output instants should be as dense
        dpi: dots an inch
        speed: of the film of a solution; 0.1 is ten times slower than the motion
        beside: function of the number of an instant, called before its picture, to move other
            things in the figure

    All samples of a batch move together, each in its own colour. With a scene, a single sample has
    the colours of its parts. A missing folder is created.

    Raises:
        ValueError: for other types than a motion, a state of another scene, another kind of file,
            and a folder that cannot be created or written.
        files.NotWritten: an OSError, where the disk is full.

    Examples:
        >>> path = tb.plot.animate(solution, "motion.gif", fps=10, speed=0.2)
    """
    path = file_of("path", path)
    for name, value in (("fps", fps), ("speed", speed)):
        tolerance(name, value)
    boolean("trail", trail)
    boolean("frames", frames)
    writer, settings = _writer(path, fps)
    folder(path.parent)
    film = _Film.of(*_motion(what), ax, plane, scene, trail, frames)
    at = torch.arange(len(film.curves)) if film.t is None else _instants(film.t, speed / fps)
    import matplotlib

    with (
        written(path, path.suffix) as part,
        matplotlib.rc_context(settings),
        writer.saving(film.ax.figure, str(part), dpi),
    ):
        for k in at.tolist():
            film.show(k)
            if beside is not None:
                beside(k)
            writer.grab_frame()
    return path


def _motion(motion: Any) -> tuple[Any, Tensor | None]:
    """States, and the times (s) of their first axis; None = that is no time."""
    if isinstance(motion, Solution):
        return motion.state, motion.t.detach().double().cpu()
    if not isinstance(motion, State) or not motion.batch_shape:
        kind = "a State of one sample" if isinstance(motion, State) else type(motion).__name__
        raise ValueError(
            f"{kind} was given to animate; a Solution, or a State with a batch, is wanted"
        )
    return motion.broadcast(), None


def _instants(t: Tensor, step: float) -> Tensor:
    """Places of those of the times t next to each of the pictures', `step` (s) apart."""
    pictures = torch.arange(t[0].item(), t[-1].item() * (1 + 1e-9), step, dtype=torch.float64)
    return torch.searchsorted((t[1:] + t[:-1]) / 2, pictures)


@dataclass(frozen=True)
class _Film:
    """Moving artists of a picture, and what they show.

    states  (time, ...)
    t       (time,) s; None = they are no motion
    curves  (time, samples, points, 2 or 3) m, frame a: axes of the beams, drawn by `lines`
    tips    (time, samples, 2 or 3) m, frame a: their last nodes, drawn by `trails`
    axes    (time, 3, 2, 2 or 3) m, frame a: section axes of the first sample's tip, from and to,
            drawn by `triad`
    solid   what has a thickness, drawn anew each time: `drawn`
    clock   the title, which says the time
    """

    ax: Axes
    states: Any
    t: Tensor | None
    curves: Any
    tips: Any
    axes: Any
    lines: list[Any]
    trails: list[Any]
    triad: list[Any]
    solid: SolidPicture | None
    drawn: list[Any]
    clock: Any

    @classmethod
    def of(
        cls,
        states: Any,
        t: Tensor | None,
        ax: Axes | None,
        plane: str | None,
        scene: Scene | None,
        trail: bool,
        frames: bool,
    ) -> _Film:
        """Film of states, axes with room for the whole motion. Raises ValueError as `shape`."""
        position, turn = nodes_of(states)
        times = states.position.shape[0]
        ax, seen = prepared(ax, plane, position)
        solid = None if scene is None else SolidPicture.of(scene, states, ax, seen, None)
        curves = axis_curves(rows_of(states), position, turn[..., 0])[..., seen]
        curves = curves.reshape(times, len(position) // times, *curves.shape[-2:])
        tip, R = (
            x.reshape(times, curves.shape[1], *x.shape[1:]) for x in (position[:, -1], turn[:, -1])
        )
        reach = 0.1 * torch.linalg.vector_norm(position[0].diff(dim=0), dim=-1).sum()
        start = tip[:, 0, None].expand(times, 3, 3)
        triad = torch.stack((start, start + reach * R[:, 0].mT), -2)[..., seen]

        def line(color: Any, **style: Any) -> Any:
            return ax.plot(*([] for _ in seen), color=color, **style)[0]

        room = curves.flatten(0, -2) if solid is None else solid.reach(states)[:, seen]
        framed(ax, seen, room)
        for first in numbers(curves[0]) if solid is None else ():
            ax.plot(*first.T, color="0.85", lw=1.8, zorder=0)
        samples = range(curves.shape[1])
        return cls(
            ax,
            states,
            t,
            numbers(curves),
            numbers(tip[..., seen]),
            numbers(triad),
            lines=[line(f"C{i % 10}", lw=2.2) for i in samples] if solid is None else [],
            trails=[line(f"C{i % 10}", lw=0.8, alpha=0.6) for i in samples] if trail else [],
            triad=[line(color, lw=1.6) for color in TRIAD] if frames else [],
            solid=solid,
            drawn=[],
            clock=None if t is None else ax.set_title(" ", **CLOCK),
        )

    def show(self, k: int) -> None:
        """Picture of the instant k."""
        for i, line in enumerate(self.lines):
            _put(line, self.curves[k, i])
        for i, line in enumerate(self.trails):
            _put(line, self.tips[: k + 1, i])
        for i, line in enumerate(self.triad):
            _put(line, self.axes[k, i])
        if self.t is not None:
            self.clock.set_text(f"t = {self.t[k].item():.3f} s")
        if self.solid is not None:
            while self.drawn:
                self.drawn.pop().remove()
            self.drawn.extend(self.solid.draw(self.states[k]))


def _writer(path: Path, fps: float) -> tuple[Any, dict[str, Any]]:
    """Writer of matplotlib's for the kind of file, and settings that hold while it writes. Raises
    ValueError for a kind that is not known, ImportError without matplotlib, RuntimeError without
    ffmpeg.
    """
    if path.suffix not in (".gif", ".mp4"):
        raise refusal(f"the file {path.name!r}", "one that ends in .gif or .mp4")
    with matplotlib_wanted():
        from matplotlib.animation import FFMpegWriter, PillowWriter
    if path.suffix == ".gif":
        return PillowWriter(fps=fps), {}
    program = shutil.which("ffmpeg")
    if program is None:
        try:
            import imageio_ffmpeg
        except ImportError:
            raise RuntimeError(
                f"{path.name} wants ffmpeg, which is not installed; pip install imageio-ffmpeg has "
                "one, and a .gif needs none"
            ) from None
        program = imageio_ffmpeg.get_ffmpeg_exe()
    return FFMpegWriter(fps=fps, codec="libx264", extra_args=["-pix_fmt", "yuv420p"]), {
        "animation.ffmpeg_path": program
    }


def _put(line: Any, points: Any) -> None:
    """Points (n, 2 or 3) of a line, in place of those it had."""
    if points.shape[-1] == 3:
        line.set_data_3d(*points.T)
    else:
        line.set_data(*points.T)
