"""Programs that are kept, by the structure that they are of, and the functions that these have
traced.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from ...core.function_dependencies import Dependencies
from ...core.remembered import keep
from ..compiler.object_cache import key_of
from .adjoint import AdjointProgram
from .disk_key import key_on_disk, structure
from .kinds import Kinds
from .local_functions import LocalFunctions
from .program import NewtonProgram, StepProgram
from .tracing import Traced

T = TypeVar("T")
# by structure, with the dependencies that its key is made of
PROGRAMS: dict[tuple, tuple[NewtonProgram, Dependencies]] = {}
TRACED: dict[tuple, tuple[Traced, Dependencies]] = {}  # likewise, what their programs share
NOTHING = Dependencies()
KEPT, KEPT_TRACED = 64, 8  # of them; the one that was not asked for for longest goes first


def program_of(
    local: LocalFunctions,
    kinds: Kinds,
    held: bool,
    around: Dependencies | None = NOTHING,
    made: type[NewtonProgram] = StepProgram,
    known: Traced | None = None,
    **options: bool,
) -> NewtonProgram:
    """The program of a structure, that of an earlier scene if there was one. kinds: of all nodes
    and elements; around: what users' functions read, which is part of it; None = that is not known,
    and the program one of its own. known: functions of `local` that were traced; None = those of
    the same structure; options: of the class `made`.
    """
    kinds = kinds.distinct()
    if around is None:
        return made(local, kinds, held, **options)
    key = made, *options.items(), around.key, *structure(local, kinds, held)

    def new() -> NewtonProgram:
        traced = traced_of(local, kinds, held, around) if known is None else known
        return made(local, kinds, held, key_on_disk(key), traced, **options)

    return _kept(PROGRAMS, key, KEPT, around, new)


def traced_of(
    local: LocalFunctions, kinds: Kinds, held: bool, around: Dependencies | None
) -> Traced:
    """Functions that programs of the same structure have traced of late, see `program_of`."""
    if around is None:
        return {}
    key = around.key, *structure(local, kinds.distinct(), held)
    return _kept(TRACED, key, KEPT_TRACED, around, dict)


def _kept(
    entries: dict[tuple, tuple[T, Dependencies]],
    key: tuple,
    count: int,
    around: Dependencies,
    new: Callable[[], T],
) -> T:
    """The entry of a key, or a new one, among at most so many; with it the dependencies that the
    key is made of.
    """
    entry = entries.pop(key, None)  # other threads may ask too: at worst two of them make it
    if entry is None:
        entry = new(), around
    return keep(entries, key, entry, count)[0]


def adjoint_of(
    program: StepProgram, local: LocalFunctions, wanted: frozenset[str], around: Dependencies | None
) -> AdjointProgram:
    """The adjoint of a program, for these constants: of what users' functions were when it was
    made.
    """
    if wanted not in program.adjoints:
        key = None if program.key is None else key_of(program.key, *sorted(wanted))
        known, settings = program.traced, (program.kinds, program.held)
        known = traced_of(local, *settings, around) if known is None else known
        program.adjoints[wanted] = AdjointProgram(local, *settings, wanted, key, known)
    return program.adjoints[wanted]
