"""Law as a user gives it: from text, checked, and its values of a uniform variate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from torch import Tensor

from ..core.validation import shown
from . import laws
from .law_scores import as_own, is_of_scipy, why_none
from .laws import Constant, Law

# fmt: off
KINDS = {name.lower(): getattr(laws, name) for name in (
    "Constant", "Uniform", "Normal", "LogNormal", "Triangular", "Weibull", "Gumbel", "Truncated",
    "Empirical", "RandomField",
)}
# fmt: on


def of_text(label: str, law: Any) -> Law:
    """Law of what a file can say: a number, [least, largest], or {"law": "normal", "mean": 1.0,
    "deviation": 0.1}, by the name of a class here and of its fields; {"law": "truncated", "of":
    LAW, "least": 0.5}. Raises ValueError.
    """
    if isinstance(law, (int, float)):
        return Constant(law)
    if not isinstance(law, Mapping):
        return law
    law = dict(law)
    kind = KINDS.get(str(law.pop("law", None)).lower())
    if kind is None:
        raise ValueError(
            f'the law {law!r} was given for {label!r}; "law" is wanted, one of {", ".join(KINDS)}'
        )
    known = ["of" if field.name == "law" else field.name for field in fields(kind)]
    if unknown := [name for name in law if name not in known]:
        raise ValueError(
            f"{unknown[0]!r} was given for the law of {label!r}; {kind.__name__} has "
            f"{', '.join(known)}"
        )
    try:
        return kind(
            **{
                "law" if name == "of" else name: of_text(label, value) if name == "of" else value
                for name, value in law.items()
            }
        )
    except TypeError:
        raise ValueError(
            f"{', '.join(law) or 'nothing'} was given for the law of {label!r}; {kind.__name__} "
            f"has {', '.join(known)}"
        ) from None


def checked(name: Any, law: Law) -> Law:
    """`law` if it is one; ValueError otherwise."""
    if not isinstance(name, str):
        raise ValueError(f"a law was given for {shown(name)}; a name is wanted")
    if isinstance(law, (tuple, list)):
        numbers = len(law) == 2 and all(
            isinstance(v, (int, float)) and abs(v) < math.inf for v in law
        )
        if not numbers or not law[0] < law[1]:
            raise ValueError(
                f"the law {shown(law)} was given for {name!r}; (least, largest) is wanted"
            )
    elif not (any(hasattr(law, own) for own in ("icdf", "ppf", "of_scores")) or callable(law)):
        raise ValueError(
            f"the law {shown(law)} was given for {name!r}; a pair, a torchbeam.laws.Constant, a "
            "distribution with icdf or ppf, or a function, is wanted"
        )
    elif why := why_none(law):
        raise ValueError(
            f"the law {shown(law)} was given for {name!r}, which {why}; another is wanted, or a "
            "function of u"
        )
    return law


def of_uniform(law: Law, u: Tensor) -> Tensor:
    """Values (N,) of u (N,), uniform in (0, 1)."""
    if isinstance(law, (tuple, list)):
        return law[0] + (law[1] - law[0]) * u
    law = as_own(law) if is_of_scipy(law) else law
    return law.icdf(u) if hasattr(law, "icdf") else law(u)
