"""Repetition of a call: how many like it a run makes, by which what is prepared is weighed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_calls: ContextVar[float] = ContextVar("calls", default=1.0)


@contextmanager
def one_of(calls: float) -> Iterator[None]:
    """Within it, a call is one of so many, at least one."""
    token = _calls.set(max(calls, 1.0))
    try:
        yield
    finally:
        _calls.reset(token)


def repetitions() -> float:
    """Calls like the present one, itself included: 1 unless somebody said otherwise."""
    return _calls.get()
