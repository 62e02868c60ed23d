"""Arguments that are no tensors: switches, counts, names, functions, times, masks."""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Callable, Iterable
from functools import cache
from statistics import NormalDist
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .validation import (
    BOOLEANS,
    as_tensor,
    broadcast,
    converted,
    dense,
    finite,
    positive,
    real,
    refusal,
    scalars,
    shown,
)

LEAST_ERROR = 16 * sys.float_info.epsilon  # a relative error that may be asked for


@cache
def keywords(*takers: Any) -> list[str]:
    """Keywords of the functions that are nothing but keywords."""
    parameters = [p for f in takers for p in inspect.signature(f).parameters.values()]
    return [p.name for p in parameters if p.kind is p.KEYWORD_ONLY]


@cache
def _defaults(taker: Any) -> dict[str, Any]:
    return {p.name: p.default for p in inspect.signature(taker).parameters.values()}


def non_default(taker: Any, values: dict[str, Any]) -> dict[str, Any]:
    """Those of the arguments of a function that have another value than by default."""
    plain, defaults = (bool, int, float, str), _defaults(taker)

    def default(value: Any, usual: Any) -> bool:
        return value is usual or (isinstance(value, plain) and value == usual)

    return {name: value for name, value in values.items() if not default(value, defaults[name])}


def options(name: str, given: dict[str, Any], known: list[str]) -> None:
    """ValueError where an option is not a known one."""
    for option in given:
        if option not in known:
            raise ValueError(f"the option {option!r} was given; {name} has {', '.join(known)}")


def not_here(name: str, value: Any, call: str) -> None:
    """ValueError where an argument was given that a public call takes before it comes here."""
    if value is not None:
        raise ValueError(f"{name} was given to a call within it; {call} takes it")


def whole(name: str, value: int) -> int:
    """`value` if it is a whole number; ValueError otherwise."""
    if not _whole(value):
        raise refusal(f"{name} = {shown(value)}", "a whole number")
    return int(value)


def is_integer(value: Any) -> bool:
    """Whether this is a whole number of Python."""
    return isinstance(value, int) and not isinstance(value, bool)


def _whole(value: Any) -> bool:
    """Whether this is a whole number that a computer counts to."""
    kind = isinstance(value, (int, np.integer)) and not isinstance(value, BOOLEANS)
    return kind and abs(value) <= sys.maxsize


def place(name: str, value: int, count: int, there: str) -> int:
    """`value` if it is the place of one of `count` things, from either end; else ValueError."""
    if not -count <= whole(name, value) < count:
        there = f"{there} 0 to {count - 1}" if count else "there is none"
        raise ValueError(f"{name} = {value} was given; {there}")
    return int(value)


def count(name: str, value: int, least: int = 1) -> int:
    """`value` if it is a whole number of at least `least`; ValueError otherwise.

    Examples:
        >>> extend.count("elements", 4, 1)
        4
    """
    if not _whole(value) or value < least:
        raise refusal(f"{name} = {shown(value)}", f"a whole number of at least {least}")
    return int(value)


def boolean(name: str, value: bool) -> bool:
    """`value` if it is True or False; ValueError otherwise."""
    if not isinstance(value, BOOLEANS):
        raise refusal(f"{name} = {shown(value)}", "True or False")
    return bool(value)


def choice(name: str, value: Any, known: Iterable[Any]) -> Any:
    """`value` if it is one of the `known` strings (or None, where that is one); ValueError
    otherwise.

    Examples:
        >>> extend.choice("method", "midpoint", ("midpoint", "rk4"))
        'midpoint'
    """
    if not isinstance(value, (str, type(None))) or value not in known:
        raise ValueError(
            f"{name} = {shown(value)} was given; {', '.join(map(repr, known))} are there"
        )
    return value


def function(name: str, value: Any, *arguments: str, named: Iterable[str] = ()) -> Any:
    """`value` if it can be called, with these arguments; ValueError otherwise."""
    if not callable(value):
        raise refusal(f"{name} = {shown(value)}", f"a function{_of(arguments, named)}")
    if arguments or named:
        try:
            inspect.signature(value).bind(*arguments, **dict.fromkeys(named))
        except TypeError as error:
            raise ValueError(
                f"{name} = {shown(value)} was given ({error}); a function{_of(arguments, named)} "
                "is wanted"
            ) from None
        except ValueError:  # one of C's, that does not say what it takes
            pass
    return value


def function_of(*arguments: str) -> Callable[[str, Any], Any]:
    """The same as a check of a field, see `core.declared`."""
    return lambda name, value: function(name, value, *arguments)


def _of(arguments: Iterable[str], named: Iterable[str]) -> str:
    every = ", ".join((*arguments, *(f"{name}=" for name in named)))
    return f" of {every}" if every else ""


def listed(value: Any) -> tuple[Any, ...]:
    """A sequence's members, or one thing by itself."""
    several = isinstance(value, Iterable) and not isinstance(value, str)
    return tuple(value) if several and getattr(value, "ndim", 1) > 0 else (value,)


def batch(name: str, value: Any) -> torch.Size:
    """Batch axes: a sequence of whole numbers that are not negative; ValueError otherwise."""
    if not isinstance(value, (list, tuple)):
        raise refusal(f"{name} = {shown(value)}", "a sequence of sizes")
    return torch.Size(count(f"an axis of {name}", size, least=0) for size in value)


def instance(name: str, value: Any, wanted: type) -> Any:
    """`value` if it is an object of torchbeam's class `wanted`; ValueError otherwise."""
    if not isinstance(value, wanted):
        raise refusal(f"{name} of type {type(value).__name__}", f"a torchbeam.{wanted.__name__}")
    return value


def number(name: str, value: Any, *, infinite: bool = False) -> float:
    """One finite real number, of Python, NumPy or a tensor, as Python's; ValueError otherwise."""
    parsed = converted(value, torch.float64) if value is not None else torch.empty(0)
    if parsed.ndim or not (torch.isfinite(parsed) or (infinite and torch.isinf(parsed))):
        raise refusal(f"{name} = {shown(value)}", f"one {'' if infinite else 'finite '}number")
    return parsed.item()


def level_of(name: str, value: Any) -> float:
    """A probability in (0, 1); ValueError otherwise."""
    level = number(name, value)
    if not 0 < level < 1:
        raise refusal(f"{name} = {level:g}", "a probability between 0 and 1")
    return level


def quantile(name: str, value: Any) -> float:
    """c, so that a normal number is within c deviations with this probability; see `level_of`."""
    return -NormalDist().inv_cdf((1 - level_of(name, value)) / 2)


def accuracy(name: str, value: Any) -> float:
    """A relative error that is asked for, in (0, 1); ValueError otherwise."""
    tolerance(name, value)
    if value < LEAST_ERROR:
        raise ValueError(
            f"{name} = {value:g} was given; double precision resolves {LEAST_ERROR:.2g} and more"
        )
    if value >= 1:
        raise ValueError(
            f"{name} = {value:g} was given; a relative error below 1 is wanted, 0.01 for a percent"
        )
    return float(value)


def some(name: str, value: Tensor) -> Tensor:
    """`value` if it has a number at all; ValueError otherwise."""
    if not value.numel():
        raise refusal(f"{name} of shape {tuple(value.shape)}", "a number")
    return value


def instants(name: str, value: Any, like: Tensor) -> Tensor:
    """Times (...) s, one or one of each sample, as `like`; ValueError for what is none."""
    return finite(name, some(name, as_tensor(value, like.dtype, like.device)))


def instant(name: str, value: Any, like: Tensor) -> Tensor:
    """A time (0-dim) s likewise; ValueError for more than one."""
    one = instants(name, value, like)
    if one.ndim:
        raise refusal(f"{name} of shape {tuple(one.shape)}", "one instant")
    return one


def mask(name: str, value: Any, like: Tensor) -> Tensor:
    """Booleans (...) that broadcast with `like`, on its device; ValueError otherwise."""
    if not isinstance(value, Tensor) and all(
        isinstance(leaf, BOOLEANS) or getattr(leaf, "dtype", None) == np.bool_
        for leaf in scalars(value)
    ):
        value = torch.as_tensor(np.array(value), device=like.device)
    if not isinstance(value, Tensor) or value.dtype != torch.bool:
        kind = f"of {value.dtype}" if isinstance(value, Tensor) else f"= {shown(value)}"
        raise refusal(f"{name} {kind}", "booleans, one a sample,", are=True)
    what = f"{name} and samples"
    if value.ndim > like.ndim or broadcast(what, value.shape, like.shape) != like.shape:
        raise ValueError(
            f"{name} of shape {tuple(value.shape)} was given for samples of shape "
            f"{tuple(like.shape)}; one a sample is wanted"
        )
    return value.to(like.device)


def tolerance(name: str, value: Any, *, zero: bool = False, each: bool = False) -> Any:
    """`value`, or with `each` a tensor, if positive and finite (or zero); ValueError otherwise."""
    if isinstance(value, Tensor):
        if value.ndim and not each:
            raise refusal(f"{name} of shape {tuple(value.shape)}", "one number")
        return positive(name, some(name, real(value)), zero=zero)
    if not _real(value) or not (0 < value < math.inf or (zero and value == 0)):
        wanted = "a non-negative" if zero else "a positive"
        raise refusal(f"{name} = {shown(value)}", f"{wanted} finite number")
    return value


def step_size(name: str, value: float) -> float:
    """`value` if it is a positive finite Python number; ValueError otherwise."""
    if not _real(value) or not (0 < value < math.inf):
        raise refusal(f"{name} = {shown(value)}", "a positive finite number of seconds")
    return float(value)


def _real(value: Any) -> bool:
    """Whether this is a real number of Python or NumPy, none that double precision cannot hold."""
    kind = isinstance(value, (int, float, np.integer, np.floating))
    large = isinstance(value, int) and abs(value) > sys.float_info.max
    return kind and not isinstance(value, BOOLEANS) and not large


def duration(name: str, value: float | Tensor, dtype: torch.dtype, device: torch.device) -> Tensor:
    """`value` as a 0-dim tensor if it is a positive finite number; ValueError otherwise."""
    if not isinstance(value, Tensor):
        return torch.as_tensor(step_size(name, value), dtype=dtype, device=device)
    if value.ndim or value.is_complex() or value.dtype == torch.bool:
        raise refusal(
            f"{name} of shape {tuple(value.shape)} and {value.dtype}", "one number of seconds"
        )
    return positive(name, dense(value).to(dtype=dtype, device=device))
