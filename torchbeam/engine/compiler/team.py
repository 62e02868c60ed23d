"""Team: torch's own threads, by which native code runs too.

Behind an operation that torch has divided, its other threads wait busily for the next one, some
milliseconds long. Threads of one's own would share the cores with them; so native code is given to
these themselves, through the OpenMP library that torch has loaded. Where it has none that is called
so, or after a fork, which OpenMP's threads do not survive, they are threads of Python.
"""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

from ...core.one_thread import threads
from ...core.openmp import openmp
from .library import Library
from .object_cache import ObjectCache

# a thread calls function(arguments[k]) of each k from its own number on, by so many as there are
# threads; data: function, numbers of a thread and of threads, how many arguments there are, these
TEXT = """
define void @share(ptr %data) nounwind {
entry:
  %function = load ptr, ptr %data
  %at_number = getelementptr i64, ptr %data, i64 1
  %number = load ptr, ptr %at_number
  %at_threads = getelementptr i64, ptr %data, i64 2
  %threads = load ptr, ptr %at_threads
  %at_count = getelementptr i64, ptr %data, i64 3
  %count = load i64, ptr %at_count
  %own = call i32 %number()
  %first = sext i32 %own to i64
  %all = call i32 %threads()
  %every = sext i32 %all to i64
  br label %loop
loop:
  %k = phi i64 [%first, %entry], [%next, %body]
  %more = icmp slt i64 %k, %count
  br i1 %more, label %body, label %exit
body:
  %place = add i64 %k, 4
  %at_arguments = getelementptr i64, ptr %data, i64 %place
  %arguments = load ptr, ptr %at_arguments
  call void %function(ptr %arguments)
  %next = add i64 %k, %every
  br label %loop
exit:
  ret void
}
"""


class Team(NamedTuple):
    """What OpenMP is called by: its function, and addresses of those that tell a thread its number
    and that of all; share: of the function above; library: holds it.
    """

    parallel: Callable[[int, int, int, int], None]
    number: int
    threads: int
    share: int
    library: Library


def in_threads(function: Callable[[Any], None], arguments: Sequence[Any], held: Any) -> None:
    """function(x) of each of the arrays `arguments`, a native one, each by a thread; held: what it
    reads and writes, which a thread of Python keeps, should nobody wait for it.
    """
    team = team_of(os.getpid())
    if team is None:
        others = [
            threading.Thread(target=lambda x, held: function(x), args=(x, held))
            for x in arguments[1:]
        ]
        for thread in others:
            thread.start()
        function(arguments[0])
        for thread in others:
            thread.join()
        return
    numbers = _address(function), team.number, team.threads, len(arguments)
    data = (ctypes.c_int64 * (len(numbers) + len(arguments)))(
        *numbers, *map(ctypes.addressof, arguments)
    )
    # of another number of threads than torch's operations, these would begin and end each time
    team.parallel(team.share, ctypes.addressof(data), threads(), 0)


@cache
def team_of(process: int) -> Team | None:
    """Of a process; None where there is none, as in one that was forked."""
    known = openmp() if process == PROCESS else None
    if known is None or not hasattr(known, "GOMP_parallel"):
        return None
    number, threads = _address(known.omp_get_thread_num), _address(known.omp_get_num_threads)
    parallel = known.GOMP_parallel
    parallel.argtypes = ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_uint
    parallel.restype = None
    library = Library(TEXT, ObjectCache())
    return Team(parallel, number, threads, library.address("share"), library)


def _address(function: Any) -> int:
    return ctypes.cast(function, ctypes.c_void_p).value or 0


PROCESS = os.getpid()  # that has loaded torch
