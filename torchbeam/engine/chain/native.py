"""Native program: local functions traced, laid out in memory, and compiled for lanes of samples."""

from __future__ import annotations

import ctypes
import logging
import time
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from functools import cache, cached_property, partial
from inspect import signature
from math import prod
from typing import Any

import torch

from ...core.leaves import detached
from ..compiler.function import Function, Functions
from ..compiler.library import Library
from ..compiler.llvm import Module
from ..compiler.object_cache import ObjectCache
from ..compiler.shared_ends import share_ends
from .disk_key import store_layout, stored_layout
from .interaction_sorts import ENDS
from .interactions import kinds_of, present
from .kinds import Kinds, without_side
from .layout import GIVEN, Layout, largest, sizes
from .local_functions import LocalFunctions
from .record_code import RecordCode
from .sorts import ELEMENT, LOAD, NODE, Sort
from .tracing import Shapes, Traced, Tracing

SMALL = 60  # operations of a function that is rather written into the driver than called
LOG = logging.getLogger("torchbeam")


class NotCompiled(RuntimeError):
    """Error: the compiler could not make native code."""


class NativeProgram:
    """kinds: that there are of nodes and elements; held: whether there are supports; key: of the
    structure, by which the layout and the object code are kept on disk, so that another process
    need not trace; None = by the code's text alone. known: functions that programs of the same
    trees have traced, see `Tracing`.

    traced     the same, of a structure without a key, for what users wrote may read other things
               later than it did then; None = by a key, nothing else is read

    functions  by name, as the driver calls them
    w, k       numbers of a node's unknowns, and of an element's stress
    layout     of the memory
    seconds    that tracing took
    """

    driver: type[RecordCode]

    def __init__(
        self,
        local: LocalFunctions,
        kinds: Kinds,
        held: bool,
        key: str | None = None,
        known: Traced | None = None,
    ) -> None:
        known = {} if known is None else known
        self.traced = known if key is None else None
        self.kinds, self.held, self.dtype = kinds, held, local.model.length.dtype
        self.state, self.element_state, self.sample_state = (
            local.state,
            local.element_state,
            local.sample_state,
        )
        self.key, self.seconds = key, 0.0
        self.order, self.sides = local.order, local.sides
        self.w, self.k = local.model.space.unknowns, local.order * local.model.space.dims.strain
        self._libraries: dict[Any, Any] = {}
        self._untraced: tuple[LocalFunctions, Traced] | None = (local, known)
        layout = None if key is None else stored_layout(key)
        if layout is None:
            layout = self._traced_layout()
            if key is not None:
                store_layout(key, layout)
        else:
            values = {field.name: detached(getattr(local, field.name)) for field in fields(local)}
            self._untraced = replace(local, **values), known
        self.layout = layout

    @cached_property
    def functions(self) -> Functions:
        begin, (local, known) = time.perf_counter(), self._untraced
        if any(sort.far for sort in present(self.kinds)):
            LOG.warning(
                "%s for beams or bodies that touch is traced and compiled, which takes some ten "
                "seconds of this processor, once for all scenes of this kind",
                type(self).__name__,
            )
        tracing = Tracing(local, known)
        self.shapes = tracing.shapes
        functions = self._functions(tracing)
        self.seconds, self._untraced = time.perf_counter() - begin, None
        return functions

    def _traced_layout(self) -> Layout:
        _ = self.functions
        return self._layout()

    def _functions(self, traced: Tracing) -> Functions:
        raise NotImplementedError

    def _layout(self) -> Layout:
        raise NotImplementedError

    def run(self, lanes: int, cells: int = 1) -> Callable[[Any], None]:
        """The native function for so many lanes, of which each sample has as many as it has cells:
        it takes an array of its arguments, see `RecordCode.ARGS`. Raises NotCompiled where the
        compiler fails.
        """
        form = lanes if cells == 1 else (lanes, cells)
        if form not in self._libraries:
            begin = time.perf_counter()
            try:
                library = Library(
                    partial(self.text, lanes, cells),
                    ObjectCache(),
                    None if self.key is None else f"{self.key} {form}",
                )
            except Exception as error:
                raise NotCompiled(f"{type(error).__name__}: {error}") from error
            function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(library.address("run"))
            self._libraries[form] = library, function
            LOG.info(
                "%s for %d sample(s) at once: traced in %.2f s, %s in %.2f s",
                type(self).__name__,
                lanes,
                self.seconds,
                "compiled" if library.compiled else "loaded",
                time.perf_counter() - begin,
            )
        return self._libraries[form][1]

    def lanes(self) -> int:
        """As many samples as a register of this processor holds."""
        return vector_bytes() // torch.empty((), dtype=self.dtype).element_size()

    def text(self, lanes: int, cells: int = 1) -> str:
        """What the compiler gets."""
        module = Module(lanes, self.dtype)
        for name, function in self.functions.items():
            module.define(name, function, inline=function.operations() <= SMALL)
        of = module, self.functions, self.layout, self.kinds, self.held, cells
        module.added.append(self.coded(*of).text())
        return module.text()

    def coded(self, *of: Any) -> RecordCode:
        """What writes the driver."""
        return self.driver(*of)

    def finishing(self, traced: Tracing) -> Functions:
        """What becomes of rows of all sorts at the end of a step, by kind."""
        return {
            f"finish {sort.name} {k}": traced(
                partial(traced.local.finished, sort, kind), traced.of(sort)
            )
            for sort in (*ENDS, LOAD)
            if sort is not ELEMENT or traced.local.element_ends
            for k, kind in kinds_of(self.kinds, sort)
        }

    def asked(self, sort: Sort, kind: Any) -> list[str]:
        """What of a balance goes into the equations."""
        if sort is NODE:
            return ["balance"]
        if sort in (ELEMENT, LOAD):
            return [*(f"{side}.balance" for side in self.sides), *["gap"] * (sort is ELEMENT)]
        return [*(f"{side}.push" for side in kind.sides), *["rhs"] * kind.multiplied]

    @property
    def given_by_elements(self) -> str:
        """The packed field that elements give: for the rows of their ends, or of three nodes."""
        return GIVEN[self.order]

    def outputs(self, name: str, *fields: str) -> list[tuple[str, int]]:
        """(field, components) of a function's outputs, all or those of `fields` that it has."""
        there = sizes(self.functions, name)
        return [(field, there[field]) for field in fields or there if field in there]

    def largest(self, name: str, *fields: str) -> list[tuple[str, int]]:
        """The same of the functions "name 0", "name 1" ... of all kinds, the most of each."""
        there = largest(self.functions, name)
        return [(field, there[field]) for field in fields or there if field in there]

    def with_ends(
        self,
        nodes: list[Function],
        elements: list[Function],
        unknown: Iterable[str],
        common: Iterable[str],
    ) -> tuple[list[Function], list[Function]]:
        """Functions of each kind of nodes and of elements, where what an element computes of one of
        its nodes alone is computed by that node; see `share_ends`.
        """
        sides = [dict(zip(self.sides, kind.ends, strict=True)) for kind in self.kinds.elements]
        rests, ends = share_ends([*zip(elements, sides, strict=True)], unknown, common)
        return [
            node.joined(ends[kind.end]) if kind.end in ends else node
            for node, kind in zip(nodes, self.kinds.nodes, strict=True)
        ], rests

    def _of_kinds(
        self, traced: Tracing, function: Callable, kinds: Iterable[Any], fields: Shapes
    ) -> Functions:
        """A function of nodes or of elements, of each of these kinds (None = of that there is
        none): "finish element 0", ...
        """
        word = function.__name__.replace("_", " ")
        return {
            f"{word} {k}": traced(partial(function, kind), fields)
            for k, kind in enumerate(kinds)
            if kind is not None
        }

    @staticmethod
    def _of_numbers(traced: Tracing, function: Callable, without: tuple[str, ...] = ()) -> Function:
        """A function all of whose arguments are numbers of a sample; without some of them."""
        names = [name for name in signature(function).parameters if name not in without]
        return traced(function, dict.fromkeys(names, ()))

    def constants(self, kind: str) -> list[tuple[str, int]]:
        """(field, components) of the constants of a kind that functions read."""
        read = {
            without_side(field): prod(shape)
            for function in self.functions.values()
            for field, shape in function.inputs.items()
        }
        return sorted((name, size) for name, size in read.items() if name.startswith(f"{kind}."))


@cache
def vector_bytes() -> int:
    """Of a register of this processor."""
    import llvmlite.binding as binding

    features = binding.get_host_cpu_features()
    return 64 if features.get("avx512f") else 32 if features.get("avx") else 16
