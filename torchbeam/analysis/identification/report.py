"""Reports of a fit and of a design: one page of HTML that holds all of it, pictures embedded."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

from torch import Tensor

from ...core import files
from ...core.validation import as_tensor, shown
from ...plot.canvas import grid, numbers
from ...plot.identification import correlation
from ...plot.identification import design as design_picture
from ...plot.identification import fit as fit_picture
from .prediction import Prediction
from .table import parameter_rows

DPI = 110
COLUMNS = 3  # channels of a picture of predictions
STYLE = """body { font: 15px/1.5 sans-serif; max-width: 70em; margin: 2em auto; padding: 0 1em }
table { border-collapse: collapse; margin: 1em 0 } img { max-width: 100% }
th, td { padding: .2em .8em; text-align: right; border-bottom: 1px solid #ddd }
th:first-child, td:first-child { text-align: left } .doubt { color: #a00 }"""


def write_report(
    fit: Any, path: str | Path, level: float, predictions: Mapping[str, Any] | None, reason: str
) -> Path:
    """See `Fit.report`; `reason`: the status in words."""
    path = files.file_of("path", path, ".html")
    parts = [_summary(fit, reason), _intervals(fit, level), _data(fit), *_pictures(fit)]
    for name, row in _checked(predictions).items():
        parts.append(_prediction(name, *row))
    return _written(path, "Fit", parts)


def write_design(plan: Any, path: str | Path) -> Path:
    """See `Design.report`."""
    path = files.file_of("path", path, ".html")
    said = "".join(f"<p>{escape(text)}.</p>" for text in plan.said())
    tables = [_table(head, rows) for head, *rows in plan.tables()]
    return _written(path, "Design", [said, *tables, _picture(design_picture(plan)[0])])


def _written(path: Path, title: str, parts: list[str]) -> Path:
    """The file of a page that holds these parts."""
    page = (
        f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f"<style>{STYLE}</style></head><body><h1>{title}</h1>{''.join(parts)}</body></html>\n"
    )
    files.folder(path.parent)
    files.write(path, page)
    return path


def _summary(fit: Any, reason: str) -> str:
    """What was found, and what is doubtful."""
    count = sum(int((~r.data.isnan()).sum()) for r in fit.readings)
    lines = [
        f"{reason.capitalize()} in {fit.iterations} iterations; misfit (RMS) "
        f"{fit.misfit.item():.4g}, of {count} data and {len(fit.theta)} parameters."
    ]
    lines += [f"Noise of {name}: {value:.3g}." for name, value in fit.noise.items()]
    lines += [
        f"Noise of {name}: correlation {rho:.3g} from one reading to the next."
        for name, rho in fit.memory.items()
    ]
    said = [*fit.unidentifiable, *fit.hints]
    doubts = "".join(f'<li class="doubt">{escape(doubt)}</li>' for doubt in said)
    nothing = "<p>Nothing looks wrong.</p>"
    text = "".join(f"<p>{escape(line)}</p>" for line in lines)
    return f"{text}<h2>Doubts</h2>{f'<ul>{doubts}</ul>' if said else nothing}"


def _intervals(fit: Any, level: float) -> str:
    rows = [
        (*row[:3], row[3] or "not told by the data", f"{freedom:.3g}")
        for row, freedom in zip(parameter_rows(fit, level), fit.freedom.tolist(), strict=True)
    ]
    head = ("parameter", "value", "deviation", f"{100 * level:g} % interval", "degrees of freedom")
    return f"<h2>Parameters</h2>{_table(head, rows)}"


def _data(fit: Any) -> str:
    """Each channel in numbers."""
    rows = []
    for reading in fit.readings:
        for name, data, y in reading.channels():
            off = (data - y)[~data.isnan()]
            if len(off):
                sizes = (off.square().mean().sqrt().item(), off.mean().item(), off.abs().max())
                rows.append((name or "data", f"{len(off)}", *(f"{v:.3g}" for v in sizes)))
    head = ("channel", "readings", "RMS of data - model", "mean", "largest")
    return f"<h2>Data</h2>{_table(head, rows)}"


def _pictures(fit: Any) -> list[str]:
    """Data, model and residuals of each measurement over time, and the correlations."""
    series = [r for r in fit.readings if r.data.ndim and len(r.data) > 1]
    drawn = [_picture(fit_picture(replace(fit, readings=(reading,)))[0]) for reading in series]
    pictures = ["<h2>Fit and residuals</h2>", *drawn] if drawn else []
    if len(fit.names) > 1:
        pictures += ["<h2>Correlation</h2>", _picture(correlation(fit))]
    return pictures


def _prediction(name: str, times: Tensor, predicted: Prediction, data: Tensor | None) -> str:
    y, low, high = (v.reshape(len(v), -1) for v in predicted)
    channels = y.shape[1]
    places = grid(-(-channels // COLUMNS), min(channels, COLUMNS))
    text = f"Bands hold {100 * predicted.level:g} % of all cases, each reading by itself."
    for k in range(channels):
        ax, order = places[k], times.argsort()
        ax.fill_between(
            *(numbers(v[order]) for v in (times, low[:, k], high[:, k])),
            color="C0", alpha=0.2, lw=0,
        )  # fmt: skip
        ax.plot(numbers(times[order]), numbers(y[order, k]), "C0", lw=1.2, label="predicted")
        if data is not None:
            values = data.reshape(len(data), -1)[:, k]
            ax.plot(numbers(times), numbers(values), ".", ms=4, color="C3", label="measured")
        ax.set(xlabel="time / s", title=f"{name} {k}" if channels > 1 else name)
    places[0].legend(frameon=False, fontsize=8)
    if data is not None:
        there = ~data.isnan()
        inside = ((data >= predicted.low) & (data <= predicted.high))[there].double().mean().item()
        rms = (data - predicted.y)[there].square().mean().sqrt().item()
        text += f" Of {int(there.sum())} readings that were measured {100 * inside:.0f} % lie in "
        text += f"them; RMS of data - prediction {rms:.3g}."
    return f"<h2>Prediction: {escape(name)}</h2><p>{text}</p>{_picture(places[0])}"


def _checked(predictions: Any) -> dict[str, tuple[Tensor, Prediction, Tensor | None]]:
    """Times, prediction and data by name."""
    if predictions is None:
        return {}
    if not isinstance(predictions, Mapping):
        raise ValueError(
            f"predictions = {shown(predictions)} were given; a dict, name -> (times, prediction) "
            "or (times, prediction, data), is wanted"
        )
    checked = {}
    for name, row in predictions.items():
        times, one, data = (*row, None)[:3] if isinstance(row, tuple) else (None, None, None)
        if not isinstance(one, Prediction) or not one.y.ndim:
            raise ValueError(
                f"predictions of {shown(name)} = {shown(row)} were given; (times, prediction) or "
                "(times, prediction, data) are wanted"
            )
        times = as_tensor(times, one.y.dtype)
        data = None if data is None else as_tensor(data, one.y.dtype)
        if times.shape != one.y.shape[:1] or (data is not None and data.shape != one.y.shape):
            raise ValueError(
                f"times of shape {tuple(times.shape)} were given to report a prediction of shape "
                f"{tuple(one.y.shape)}; one for each reading is wanted, and data of that shape"
            )
        checked[str(name)] = times, one, data
    return checked


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    def row(cells: tuple[str, ...], kind: str) -> str:
        return f"<tr>{''.join(f'<{kind}>{escape(cell)}</{kind}>' for cell in cells)}</tr>"

    return f"<table>{row(head, 'th')}{''.join(row(cells, 'td') for cells in rows)}</table>"


def _picture(ax: Any) -> str:
    """Of the figure that axes are in."""
    file = io.BytesIO()
    ax.figure.savefig(file, dpi=DPI, format="png", bbox_inches="tight")
    picture = base64.b64encode(file.getvalue()).decode()
    return f'<p><img alt="" src="data:image/png;base64,{picture}"></p>'
