"""Laws of random parameters.

A law is (least, largest), uniform between; one of the classes here; anything with `icdf`, as
torch.distributions have, or with `ppf`, as SciPy's have; or a function of u (N,), uniform in (0,
1). `RandomField` is a law of many numbers.
"""

from __future__ import annotations

from typing import Any

from ..core.entry_point import entry_points
from ..core.missing_name import by_word, near_names
from .empirical_law import Empirical
from .parametric_laws import Constant, Gumbel, LogNormal, Normal, Triangular, Uniform, Weibull
from .random_field import RandomField
from .truncated_law import Truncated

# fmt: off
__all__ = [
    "Constant", "Empirical", "Gumbel", "LogNormal", "Normal", "RandomField", "Triangular",
    "Truncated", "Uniform", "Weibull",
]
# fmt: on
entry_points(globals(), __all__)
Law = Any

# what others call so
ELSEWHERE = by_word(
    {
        "Constant": "deterministic",
        "Empirical": "histogram",
        "Normal": "gaussian",
        "RandomField": "gaussianprocess",
        "Weibull": "exponential",
    }
)
near_names(globals(), ELSEWHERE)
