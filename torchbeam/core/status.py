"""Status of a sample: codes and their sentences; samples by their places."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from torch import Tensor

_kept: ContextVar[list[Tensor] | None] = ContextVar("kept", default=None)
SUCCESS, DIVERGED, BROKEN, FAILED, UNDERFLOW, TOO_MANY = range(6)
STATUS = {
    SUCCESS: "success",
    DIVERGED: "Newton's method did not converge; a smaller step may help",
    BROKEN: "a parameter, a load or the state is infinite or not a number",
    FAILED: (
        "the explicit method failed: its step shrank to nothing, the rates were not finite, "
        "or it made energy that nothing gave"
    ),
    UNDERFLOW: (
        "no step, however short, has an error within the tolerance, or a solution at all: "
        "something jumps, is not finite, or the tolerance is beyond what the arithmetic "
        "resolves"
    ),
    TOO_MANY: "the tolerance was not reached within max_steps; a larger one of either may help",
}


@contextmanager
def statuses() -> Iterator[list[Tensor]]:
    """Statuses (...) of calls within it where samples failed: nothing else warns of these."""
    token = _kept.set(kept := [])
    try:
        yield kept
    finally:
        _kept.reset(token)


def kept(status: Tensor) -> bool:
    """Whether somebody keeps the status (...) of samples that failed, and tells of them."""
    listening = _kept.get()
    if listening is not None:
        listening.append(status)
    return listening is not None


def stopped(failed: Tensor, t: Tensor, reason: str) -> str:
    """Sentence on samples (...) that stopped after t (...) s, by the first of them."""
    when = t.expand(failed.shape)[failed][0].item()
    return f"{first_named(failed)} stopped after t = {when:.6g} s: {reason}"


def first_named(mask: Tensor, alone: str = "the sample") -> str:
    """The first sample of a mask (...) in a sentence, "sample 1 (2 of 6)", or what is called so
    where there are no batch axes.
    """
    first = mask.nonzero()[0].tolist()
    which = f"sample {first[0] if len(first) == 1 else tuple(first)}" if first else alone
    return f"{which} ({int(mask.sum())} of {mask.numel()})"


def named(mask: Tensor, most: int = 8) -> str:
    """Samples of a mask (...) in a sentence, "sample 1, 4 (2 of 6)": at `most` so many by their
    places, and how many of how many.
    """
    places = mask.nonzero().tolist()
    listed = [str(tuple(place) if len(place) > 1 else place[0]) for place in places[:most]]
    more = ["..."] * (len(places) > most)
    return f"sample {', '.join(listed + more)} ({len(places)} of {mask.numel()})"
