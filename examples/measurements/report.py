"""Line: what an example with measurements ends with, as one line of JSON."""

import json
from collections.abc import Iterable

from torch import Tensor

import torchbeam as tb


def line(fit: tb.Fit, names: Iterable[str], rms: Tensor, coverage: float, seconds: float) -> str:
    """JSON of the parameters `names` with their 95 % intervals, RMS (markers,) m of what was held
    out, the share of its readings that the 95 % bands hold, and how long it took.
    """
    ends = fit.interval(0.95).tolist()
    parameters = {
        name: [float(f"{x:.6g}") for x in (value, *ends[k])]
        for k, (name, value) in enumerate(zip(fit.names, fit.theta.tolist(), strict=True))
        if name.split("[")[0] in names
    }
    return json.dumps(
        {
            "parameters": parameters,
            "rms_mm": [round(1e3 * x, 2) for x in rms.tolist()],
            "coverage": round(coverage, 3),
            "seconds": round(seconds, 1),
        }
    )
