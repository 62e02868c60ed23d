"""Animations: a motion as a GIF or an MP4 file."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.files import folder, written
from ..core.validation import positive
from ..state.solution import Solution
from .canvas import Axes, is_3d, numbers
from .shapes import TRIAD, _curves, _even, _nodes, _prepared, _rows


def animate(
    solution: Solution,
    path: str | Path,
    ax: Axes | None = None,
    *,
    plane: str | None = None,
    fps: float = 25.0,
    speed: float = 1.0,
    trail: bool = True,
    frames: bool = False,
    dpi: int = 100,
) -> Path:
    """Animation of a motion, written to a file: the path of that.

    Args:
        solution: `Solution` with any batch axes
        path: ends in .gif (Pillow) or .mp4 (an ffmpeg program, or the one that comes with the
            package imageio-ffmpeg)
        ax: to draw on: what is there already stays; None = new ones
        plane: as in `shape`;  frames: with the section axes of the tip;  trail: the path of the tip
        fps: 1/s, pictures a second; each shows the output instant next to its time, so output
            instants should be as dense
        dpi: dots an inch
        speed: of the film: 0.1 is ten times slower than the motion

    All samples of a batch move together, each in its own colour. The file's folder is made where it
    is missing.

    Raises ValueError for another kind of file, and for a folder that cannot be made or written, or
    lies in none; files.NotWritten (an OSError) where the disk is full.

    Examples:
        >>> path = tb.plot.animate(solution, "motion.gif", fps=10, speed=0.2)
    """
    path = Path(path)
    for name, value in (("fps", fps), ("speed", speed)):
        positive(name, torch.as_tensor(float(value)))
    writer, settings = _writer(path, fps)
    folder(path.parent)
    film = _Film.of(solution, ax, plane, trail, frames)
    span = torch.arange(
        solution.t[0].item(), solution.t[-1].item() * (1 + 1e-9), speed / fps, dtype=torch.float64
    )
    instants = solution.t.detach().double().cpu()
    at = torch.searchsorted((instants[1:] + instants[:-1]) / 2, span)
    import matplotlib

    with (
        written(path, path.suffix) as part,
        matplotlib.rc_context(settings),
        writer.saving(film.ax.figure, str(part), dpi),
    ):
        for k in at.tolist():
            film.show(k)
            writer.grab_frame()
    return path


@dataclass(frozen=True)
class _Film:
    """Moving artists of a picture, and what they show.

    t       (time,) s
    curves  (time, samples, points, 2 or 3) m, frame a: axes of the beams, drawn by `lines`
    tips    (time, samples, 2 or 3) m, frame a: their last nodes, drawn by `trails`
    axes    (time, 3, 2, 2 or 3) m, frame a: section axes of the first sample's tip, from and to,
            drawn by `triad`
    clock   the title, which says the time
    """

    ax: Axes
    t: Tensor
    curves: Any
    tips: Any
    axes: Any
    lines: list[Any]
    trails: list[Any]
    triad: list[Any]
    clock: Any

    @classmethod
    def of(
        cls, solution: Solution, ax: Axes | None, plane: str | None, trail: bool, frames: bool
    ) -> _Film:
        """Film of a solution, before its first picture; axes with room for the whole motion. Raises
        ValueError as `shape`.
        """
        position, turn = _nodes(solution.state)
        times = len(solution.t)
        ax, seen = _prepared(ax, plane, position)
        curves = _curves(_rows(solution.state), position, turn[..., 0])[..., seen]
        curves = curves.reshape(times, -1, *curves.shape[-2:])
        tip, R = (
            x.reshape(times, curves.shape[1], *x.shape[1:]) for x in (position[:, -1], turn[:, -1])
        )
        reach = 0.1 * torch.linalg.vector_norm(position[0].diff(dim=0), dim=-1).sum()
        start = tip[:, 0, None].expand(times, 3, 3)
        triad = torch.stack((start, start + reach * R[:, 0].mT), -2)[..., seen]

        def line(color: Any, **style: Any) -> Any:
            return ax.plot(*([] for _ in seen), color=color, **style)[0]

        # room for the whole motion
        (everywhere,) = ax.plot(*numbers(curves).reshape(-1, len(seen)).T, alpha=0)
        _even(ax, seen)
        if not is_3d(ax):
            ax.figure.canvas.draw()  # equal scales settle
            ax.set_aspect("equal", adjustable="box")
            ax.set(xlim=ax.get_xlim(), ylim=ax.get_ylim())
        everywhere.remove()
        for start in numbers(curves[0]):
            ax.plot(*start.T, color="0.85", lw=1.8, zorder=0)
        samples = range(curves.shape[1])
        return cls(
            ax,
            solution.t.detach(),
            numbers(curves),
            numbers(tip[..., seen]),
            numbers(triad),
            lines=[line(f"C{i % 10}", lw=2.2) for i in samples],
            trails=[line(f"C{i % 10}", lw=0.8, alpha=0.6) for i in samples] if trail else [],
            triad=[line(color, lw=1.6) for color in TRIAD] if frames else [],
            clock=ax.set_title("t = 0", fontsize=9, loc="left", family="monospace"),
        )

    def show(self, k: int) -> None:
        """Picture of the output instant k."""
        for i, line in enumerate(self.lines):
            _put(line, self.curves[k, i])
        for i, line in enumerate(self.trails):
            _put(line, self.tips[: k + 1, i])
        for i, line in enumerate(self.triad):
            _put(line, self.axes[k, i])
        self.clock.set_text(f"t = {self.t[k].item():.3f} s")


def _writer(path: Path, fps: float) -> tuple[Any, dict[str, Any]]:
    """Writer of matplotlib's for the kind of file, and settings that hold while it writes. Raises
    ValueError for a kind that is not known, ImportError without matplotlib, RuntimeError without
    ffmpeg.
    """
    if path.suffix not in (".gif", ".mp4"):
        raise ValueError(
            f"the file {path.name!r} was given; one that ends in .gif or .mp4 is wanted"
        )
    try:
        from matplotlib.animation import FFMpegWriter, PillowWriter
    except ImportError:
        raise ImportError(
            "torchbeam.plot wants matplotlib: pip install 'torchbeam[plot]'"
        ) from None
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
