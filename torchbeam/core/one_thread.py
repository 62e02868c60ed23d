"""One thread for few numbers. Torch divides products and factors of more matrices than it has
threads, however small: on a busy machine of two cores six 6x6 systems, of 12 us on one thread, took
83 us to 3 ms of both, and up to 50 ms until the second had its turn.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from .openmp import openmp

FEW = 4096  # numbers that several threads do not solve for sooner


@contextmanager
def one_thread(numbers: int) -> Iterator[None]:
    """Operations of this thread of Python are not divided, if they are of few numbers. Torch's own
    number of threads stays: `set_num_threads` would tell it, and MKL, for good (see `dense`).
    """
    threads = torch.get_num_threads()
    library = openmp() if numbers <= FEW and threads > 1 else None
    if library is None:
        yield
        return
    library.omp_set_num_threads(1)
    try:
        yield
    finally:
        library.omp_set_num_threads(threads)
