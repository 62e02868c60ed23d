"""Numbers of users' functions, wherever these keep them."""

from __future__ import annotations

import functools
import types
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch

import torchbeam as tb
from tests.cases.metamorphic_parts import Parts, each, listed, times
from tests.cases.metamorphic_similarity import quantities, tensor


class _Factor:
    """A user's object with a number."""

    def __init__(self, function: Callable, k: float) -> None:
        self.function, self.k = function, k

    def __call__(self, *a: Any, **named: Any) -> Any:
        return times(self.k, self.function(*a, **named))

    def method(self, *a: Any, **named: Any) -> Any:
        return times(self.k, self.function(*a, **named))


def _with_default(f: Callable, k: float) -> Callable:
    def function(*a: Any, k: float = k, **named: Any) -> Any:
        return times(k, f(*a, **named))

    return function


def _nested(f: Callable, k: float) -> Callable:
    def inner(*a: Any, **named: Any) -> Any:
        return times(k, f(*a, **named))

    def outer(*a: Any, **named: Any) -> Any:
        return inner(*a, **named)

    return outer


SHELF = types.SimpleNamespace(k=1.0)


def _on_shelf(f: Callable, k: float) -> Callable:
    SHELF.k = k
    return lambda *a, **named: times(SHELF.k, f(*a, **named))


def _partial(f: Callable, k: float) -> Callable:
    return functools.partial(lambda number, *a, **named: times(number, f(*a, **named)), k)


def _in_list(f: Callable, k: float) -> Callable:
    held = [0.0, k]
    return lambda *a, **named: times(held[1], f(*a, **named))


def _in_dict(f: Callable, k: float) -> Callable:
    held = {"gain": k}
    return lambda *a, **named: times(held["gain"], f(*a, **named))


def _in_tensor(f: Callable, k: float) -> Callable:
    held = torch.tensor(k)
    return lambda *a, **named: times(
        1.0,
        [None if w is None else held * w for w in listed(f(*a, **named))]
        if isinstance(f(*a, **named), tuple)
        else held * tensor(f(*a, **named)),
    )


# fmt: off
# where the number of a user's function may be
HOLDERS: dict[str, Callable[[Callable, float], Callable]] = {
    "closure": lambda f, k: lambda *a, **named: times(k, f(*a, **named)), "default": _with_default,
    "partial": _partial,
    "method": lambda f, k: _Factor(f, k).method, "object": _Factor, "nested": _nested,
    "list": _in_list, "dict": _in_dict,
    "module": _on_shelf, "tensor": _in_tensor,
}
# fmt: on


def numbered(parts: Parts, holder: str, k: float) -> Parts:
    """Every function in a scene k times what it is, by the same code whatever k."""
    hold = HOLDERS[holder]

    def changed(of: Any) -> Any:
        if isinstance(of, tb.Load):
            return replace(
                of,
                function=hold(of.function, k),
                **({} if of.rate is None else {"rate": hold(of.rate, k)}),
            )
        new = {}
        for name in quantities(of):
            value = getattr(of, name)
            if isinstance(value, tb.Along):
                new[name] = tb.Along(hold(value.function, k))
            elif isinstance(value, tb.PerElement):
                if callable(value.value):
                    new[name] = tb.PerElement(hold(value.value, k))
            elif callable(value) and name != "moving":
                new[name] = hold(value, k)
        return replace(of, **new) if new else of

    return each(changed)(parts)
