"""Methods: the implicit ones, by name."""

from __future__ import annotations

from .generalized_alpha_method import GeneralizedAlphaMethod
from .method import Method, Midpoint
from .midpoint4 import Midpoint4

METHODS: dict[str, type[Method]] = {
    "midpoint": Midpoint,
    "midpoint4": Midpoint4,
    "generalized_alpha": GeneralizedAlphaMethod,
}
