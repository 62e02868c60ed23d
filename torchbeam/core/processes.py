"""Processes that work for this one."""

from __future__ import annotations

import os
import threading
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context, parent_process


def process_pool(count: int) -> ProcessPoolExecutor:
    """A pool of so many, begun anew (not forked, which torch's threads do not survive). Where this
    process ends, however it does, they end as well, at once: what they have not given back is lost.

    Examples:
        >>> from torchbeam.extend.commands import process_pool
        >>> with process_pool(2) as pool:
        ...     list(pool.map(abs, [-1, 2]))
        [1, 2]
    """
    return ProcessPoolExecutor(count, get_context("spawn"), initializer=_follow)


def _follow() -> None:
    """End where the process that started this one does."""
    threading.Thread(target=_end_after_parent, daemon=True).start()


def _end_after_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
