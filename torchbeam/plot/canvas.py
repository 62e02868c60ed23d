"""Canvas: axes to draw on, in figures of their own, without pyplot and its state."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from ..core.arguments import boolean, count, listed, tolerance
from ..core.files import file_of, folder, written
from ..core.validation import refusal, shown

Axes = Any  # matplotlib.axes.Axes; matplotlib is imported where something is drawn
GREY = "0.6"


def axes(size: tuple[float, float] = (6.0, 3.8), *, three: bool = False) -> Axes:
    """Axes in a new figure of the given size (inches), flat or three-dimensional. Raises
    ImportError without matplotlib.

    Examples:
        >>> ax = tb.plot.axes(size=(4, 3))
        >>> ax = tb.plot.shape(solution.state[-1], ax, plane="xz")
    """
    figure = _figure(size)
    return _tidy(figure.add_subplot(projection="3d" if boolean("three", three) else None))


def drawn_on(ax: Axes | None) -> Axes:
    """The axes that were given, or new flat ones; ValueError for what is none."""
    return axes() if ax is None else check_axes(ax)


def check_axes(ax: Any) -> Axes:
    """`ax`; ValueError for what is no axes of matplotlib's."""
    if not (hasattr(ax, "figure") and hasattr(ax, "get_lines")):
        raise refusal(f"ax = {shown(ax)}", "axes of matplotlib's", are=True)
    return ax


def drawable(name: str, value: Any, kind: str, *needed: str) -> Any:
    """`value` if it has what is drawn of it; ValueError, that names the kind, otherwise."""
    if isinstance(value, type) or not all(hasattr(value, attribute) for attribute in needed):
        raise refusal(f"{name} = {shown(value)}", kind)
    return value


def check_label(label: Any) -> Any:
    """`label` if it is a text or None; ValueError otherwise."""
    if not isinstance(label, (str, type(None))):
        raise refusal(f"label = {shown(label)}", "a text")
    return label


def grid(
    rows: int, columns: int, size: tuple[float, float] | None = None, *, three: Sequence[int] = ()
) -> list[Axes]:
    """A list of rows x columns axes, row by row, in one new figure. `size` is (width, height) in
    inches. `three` lists the numbers, counted from 0, of three-dimensional axes.

    Raises:
        ImportError: without matplotlib.

    Examples:
        >>> left, right = tb.plot.grid(1, 2)
        >>> ax = tb.plot.energies(solution, left)
        >>> ax = tb.plot.history(solution, tb.sensors.TipPosition(), right)
    """
    rows, columns = count("rows", rows), count("columns", columns)
    three = tuple(count("a place of three", i, least=0) for i in listed(three))
    figure = _figure((5.0 * columns, 3.4 * rows) if size is None else size)
    return [
        _tidy(figure.add_subplot(rows, columns, i + 1, projection="3d" if i in three else None))
        for i in range(rows * columns)
    ]


def save(ax: Axes | Sequence[Axes], path: str | Path, dpi: int = 150) -> Path:
    """Write the figure of `ax`, or of a list of axes, to a file, with `dpi` dots an inch. The
    ending of the path chooses the format (.png, .pdf, .svg ...). A missing folder is created.
    Returns the path.

    Raises:
        ValueError: for a format that matplotlib lacks, and for a folder that cannot be created or
            written.
        files.NotWritten: an OSError, where the disk is full.

    Examples:
        >>> path = tb.plot.save(tb.plot.shape(solution.state), "shapes.png")
    """
    first = ax[0] if isinstance(ax, (list, tuple)) and ax else ax
    path, figure = file_of("path", path), check_axes(first).figure
    tolerance("dpi", dpi)
    if path.suffix[1:].lower() not in figure.canvas.get_supported_filetypes():
        raise refusal(f"the file {path.name!r}", "one that ends in .png, .pdf, .svg ...")
    folder(path.parent)
    with written(path) as part:
        figure.savefig(part, dpi=dpi, format=path.suffix[1:])
    return path


@contextmanager
def matplotlib_wanted() -> Iterator[None]:
    """For its imports: without it an ImportError says where it is had from."""
    try:
        yield
    except ImportError:
        raise ImportError(
            "torchbeam.plot wants matplotlib: pip install 'torchbeam[plot]'"
        ) from None


def line_style(options: dict[str, Any], **usual: Any) -> dict[str, Any]:
    """Keywords of a line: those that a user gave, and what is usual of the others, whichever of
    matplotlib's names for the same both use (lw, linewidth). Raises ValueError for another keyword.
    """
    from matplotlib.cbook import normalize_kwargs
    from matplotlib.lines import Line2D

    style = normalize_kwargs(options, Line2D)
    for name in style:
        if not hasattr(Line2D, f"set_{name}"):
            raise ValueError(
                f"the keyword {name!r} was given to a picture; one of its own, or of matplotlib's "
                "lines, is wanted"
            )
    return normalize_kwargs(usual, Line2D) | style


def written_number(x: float) -> str:
    """A number of four digits, without an exponent as far as a million."""
    return f"{x:,.0f}" if 1e4 <= abs(x) < 1e6 else f"{x:.4g}"


def is_3d(ax: Axes) -> bool:
    """Whether axes are three-dimensional."""
    return ax.name == "3d"


def ink(ax: Axes) -> Any:
    """The colour that axes are labelled in: black, or white in a dark style."""
    return ax.xaxis.label.get_color()


def numbers(x: Tensor) -> Any:
    """NumPy array of a tensor's numbers, on the CPU and without gradient."""
    return x.detach().cpu().numpy()


def first(x: Tensor, axes: int) -> Tensor:
    """The first sample of (..., own axes), on the CPU in double precision, without gradient."""
    x = x.detach().double().cpu()
    return x.reshape(-1, *x.shape[x.ndim - axes :])[0]


def _figure(size: tuple[float, float]) -> Any:
    """Figure of the given size (inches), the caller's alone. ImportError without matplotlib."""
    with matplotlib_wanted():
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    size = tuple(tolerance("a length of size", length) for length in listed(size))
    if len(size) != 2:
        raise refusal(f"size = {shown(size)}", "two lengths, in inches,", are=True)
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    figure._repr_png_ = partial(_png, figure)
    return figure


def _png(figure: Any) -> bytes:
    """The figure as a notebook shows it."""
    file = io.BytesIO()
    figure.savefig(file, format="png")
    return file.getvalue()


def _tidy(ax: Axes) -> Axes:
    """The axes without frames and panes that say nothing; the last line of a cell shows them."""
    ax._repr_png_ = ax.figure._repr_png_
    if is_3d(ax):
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.pane.set_visible(False)
    else:
        ax.spines[["top", "right"]].set_visible(False)
    return ax
