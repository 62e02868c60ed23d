"""One thread for few numbers. Torch divides products, factors and sines of more than a few matrices
among its threads, however small these are. On a machine whose cores have other work its threads
then wait for each other, busily: an operation of 12 us on one thread took 3 ms of each core, a
Kalman filter 25 times its time, an environment's step ten times. On an idle one they gain little.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, TypeVar

import torch

from .openmp import openmp

FEW = 32768  # numbers; from there on torch divides sums, too
DENSE = 8  # numbers of a dense matrix that count as one: its eigenvalues are hardly divided
_OUTSIDE: ContextVar[int | None] = ContextVar("_OUTSIDE", default=None)

F = TypeVar("F", bound=Callable[..., Any])


def threads() -> int:
    """How many torch has outside of `one_thread`: native code is divided among these even there."""
    return _OUTSIDE.get() or torch.get_num_threads()


@contextmanager
def one_thread(numbers: int) -> Iterator[None]:
    """Operations of this thread of Python are not divided, if they are of few numbers. Torch's own
    number of threads stays: `set_num_threads` would tell it, and MKL, for good (see `dense`).

    Examples:
        >>> with extend.one_thread(numbers=100):
        ...     torch.linalg.solve(torch.eye(3).expand(8, 3, 3), torch.ones(8, 3)).shape
        torch.Size([8, 3])
    """
    count = torch.get_num_threads()
    library = openmp() if numbers <= FEW and count > 1 else None
    if library is None:
        yield
        return
    outside = _OUTSIDE.set(count)
    library.omp_set_num_threads(1)
    try:
        yield
    finally:
        library.omp_set_num_threads(count)
        _OUTSIDE.reset(outside)


def few_on_one_thread(numbers: Callable[..., int]) -> Callable[[F], F]:
    """Make a function one of `one_thread`, with the numbers that a function of the same arguments
    tells.
    """

    def decorated(function: F) -> F:
        @functools.wraps(function)
        def called(*args: Any, **kwargs: Any) -> Any:
            try:
                few = numbers(*args, **kwargs)
            except TypeError:  # of other arguments, which the function refuses itself
                return function(*args, **kwargs)
            with one_thread(few):
                return function(*args, **kwargs)

        return called  # type: ignore[return-value]

    return decorated


def numbers_of(scene: Any, *others: Any) -> int:
    """Moves of all nodes of a scene's samples, or of so many samples as a state or an input has; 0
    of what is no scene.
    """
    nodes = getattr(getattr(scene, "beam", None), "node_count", 0)
    samples = [getattr(scene, "batch_shape", torch.Size()).numel()]
    for other in others:
        if isinstance(other, dict):
            shapes = [x.shape[:-1] for x in other.values() if isinstance(x, torch.Tensor)]
        else:
            shapes = [getattr(getattr(other, "status", None), "shape", torch.Size())]
        samples += [shape.numel() for shape in shapes if isinstance(shape, torch.Size)]
    return 6 * nodes * max(samples)


def dense_numbers_of(scene: Any, state: Any = None, *_: Any, **named: Any) -> int:
    """Of the dense matrices of these moves, which count less."""
    unknowns = 6 * getattr(getattr(scene, "beam", None), "node_count", 0)
    return numbers_of(scene, state, named.get("inputs")) * unknowns // DENSE
