"""Table of a fit, for a reader."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from typing import Any

from ...core.summary import aligned

WIDTH = 110
STRONG = 0.95  # correlations above it are named
DERIVATIVES = {"forward": "forward mode", "difference": "differences", "adjoint": "the adjoint"}


def table(fit: Any, level: float, reason: dict[int, str]) -> str:
    """Text of a `Fit`."""
    rows = []
    for k, row in enumerate(parameter_rows(fit, level)):
        held = "at its bound" if fit.held[k] else ""
        rows.append((*row, "not told by the data" if fit.open[k] else held))
    head = ("parameter", "value", "deviation", f"{100 * level:g} % interval", "")
    lines = aligned([head, *rows], right=(1, 2, 3))
    lines.insert(1, "-" * max(map(len, lines)))
    numbers = sum(int((~r.data.isnan()).sum()) for r in fit.readings)
    unit = " sigma" if fit.noise or fit.freedom.isinf().all() else ""
    lines += [
        "",
        f"misfit (RMS) {fit.misfit.item():.4g}{unit} of {numbers} data, {len(fit.theta)} "
        "parameters",
        f"{reason[fit.status]} in {fit.iterations} iterations, derivatives by "
        f"{DERIVATIVES.get(fit.derivatives, fit.derivatives)}",
    ]
    if fit.noise:
        lines.append(
            "noise found: " + ", ".join(f"{name} {sigma:.3g}" for name, sigma in fit.noise.items())
        )
    for name, rho in fit.memory.items():
        lines.append(f"noise of {name}: correlation {rho:.3g} from one reading to the next")
    if len(fit.starts) > 1:
        near = ((fit.misfits - fit.misfit) <= 1e-3 * fit.misfit + 1e-12).sum().item()
        lines.append(f"{near} of {len(fit.starts)} starts end with this misfit")
    for text in (*fit.unidentifiable, *_correlated(fit), *fit.hints):
        lines += textwrap.wrap(text, WIDTH, initial_indent="- ", subsequent_indent="  ")
    return "\n".join(lines)


def parameter_rows(fit: Any, level: float) -> Iterator[tuple[str, str, str, str]]:
    """Name, value, deviation and interval of each parameter; empty what the data do not tell."""
    for k, (low, high) in enumerate(fit.interval_without_warning(level).tolist()):
        told = not fit.open[k]
        deviation = f"{fit.deviation[k].item():.2g}" if told and not fit.held[k] else ""
        interval = f"{low:.5g} to {high:.5g}" if told else ""
        yield fit.names[k], f"{fit.theta[k].item():.5g}", deviation, interval


def _correlated(fit: Any) -> list[str]:
    """Pairs that the data hardly tell apart."""
    p = len(fit.names)
    pairs = [
        (fit.correlation[i, j].item(), i, j)
        for i in range(p)
        for j in range(i)
        if not (fit.open[i] or fit.open[j] or fit.held[i] or fit.held[j])
    ]
    return [
        f"{fit.names[j]} and {fit.names[i]} are hardly told apart: correlation {c:.3f}"
        for c, i, j in sorted(pairs, key=lambda pair: -abs(pair[0]))
        if abs(c) > STRONG
    ]
