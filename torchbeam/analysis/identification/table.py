"""Table of a fit, for a reader."""

from __future__ import annotations

import textwrap
from typing import Any

from ...core.summary import aligned

WIDTH = 110
STRONG = 0.95  # correlations above it are named


def table(fit: Any, level: float, reason: dict[int, str]) -> str:
    """Text of a `Fit`."""
    interval = fit.interval_without_warning(level).tolist()
    head = ("parameter", "value", "deviation", f"{100 * level:g} % interval", "")
    rows = []
    for k, name in enumerate(fit.names):
        low, high = interval[k]
        determined, held = not bool(fit.open[k]), bool(fit.held[k])
        rows.append(
            (
                name,
                f"{fit.theta[k].item():.5g}",
                f"{fit.deviation[k].item():.2g}" if determined and not held else "",
                f"{low:.5g} to {high:.5g}" if determined else "",
                "not told by the data" if not determined else "at its bound" if held else "",
            )
        )
    lines = aligned([head, *rows], right=(1, 2, 3))
    lines.insert(1, "-" * max(map(len, lines)))
    numbers = sum(int((~r.data.isnan()).sum()) for r in fit.readings)
    unit = " sigma" if fit.noise or fit.freedom.isinf().all() else ""
    lines += [
        "",
        f"misfit (RMS) {fit.misfit.item():.4g}{unit} of {numbers} data, {len(fit.theta)} "
        "parameters",
        f"{reason[fit.status]} in {fit.iterations} iterations, derivatives by "
        f"{_by(fit.derivatives)}",
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
    said = [*fit.unidentifiable, *_correlated(fit), *fit.hints]
    return "\n".join(
        [
            *lines,
            *(
                line
                for text in said
                for line in textwrap.wrap(text, WIDTH, initial_indent="- ", subsequent_indent="  ")
            ),
        ]
    )


def _by(derivatives: str) -> str:
    return {"forward": "forward mode", "difference": "differences", "adjoint": "the adjoint"}.get(
        derivatives, derivatives
    )


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
        for c, i, j in sorted(pairs, key=lambda one: -abs(one[0]))
        if abs(c) > STRONG
    ]
