"""Program: the local functions of a step, traced, laid out in memory and compiled, once for all scenes of a structure."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache, partial
from math import prod
from typing import Any

import torch
from torch import Tensor

from ...core.derivatives import cache_of
from ...core.leaves import Tree, map_leaves
from ...nodal.coordinates.planar import Plane
from ...solvers.compiled.function import Function
from ...solvers.compiled.library import Library
from ...solvers.compiled.llvm import Module
from ...solvers.compiled.object_cache import ObjectCache
from ...solvers.compiled.split import HOISTED, split
from ...solvers.compiled.trace import trace
from .constants import flattened
from .driver import SUMS, Driver
from .layout import ELEMENTS, MOVES, NODES, ONE, SUPPORTS, TWO, Layout
from .local_functions import NODE, LocalFunctions, NodeKind

SAMPLE = ("over", "done", "before", "iterations", "status", "moving", "cosine", "good", "found_status", "last_status", "work")
SIDES = ("balance", "asked", "inertia", "D")


class Program:
    """kinds: of the nodes; held: whether there are supports.

    functions  by name, see `Driver`
    layout     of a step's memory
    """

    def __init__(self, local: LocalFunctions, kinds: tuple[NodeKind, ...], held: bool) -> None:
        self.kinds, self.held, self.dtype = kinds, held, local.model.length.dtype
        space = local.model.space
        self.w, self.k = space.unknowns, space.strain
        self.functions = _Tracing(local, kinds, held).functions()
        self.layout = self._layout()
        self._libraries: dict[int, Any] = {}

    def run(self, lanes: int) -> Callable[[Any], None]:
        """The native function for so many lanes: it takes an array of its arguments, see `driver.ARGS`."""
        if lanes not in self._libraries:
            library = Library(self.text(lanes), ObjectCache())
            function = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(library.address("run"))
            self._libraries[lanes] = library, function
        return self._libraries[lanes][1]

    def lanes(self) -> int:
        """As many samples as a register of this processor holds."""
        return vector_bytes() // torch.empty((), dtype=self.dtype).element_size()

    def text(self, lanes: int) -> str:
        """What the compiler gets."""
        module = Module(lanes, self.dtype)
        for name, function in self.functions.items():
            module.define(name, function)
        module.added.append(Driver(module, self.functions, self.layout, len(self.kinds), self.held).text())
        return module.text()

    def given(self, record: str) -> list[tuple[str, int, int]]:
        """(field, its number among the constants, components) that are taken from tensors."""
        return [(name, int(name.rpartition(".")[2]), size) for name, (_, size) in self.layout.records[record].fields.items()
                if "." in name]

    def _layout(self) -> Layout:
        functions, w, k = self.functions, self.w, self.k
        used = {field.removeprefix("i.").removeprefix("j."): prod(shape)
                for function in functions.values() for field, shape in function.inputs.items()}

        def inputs(kind: str) -> list[tuple[str, int]]:
            return sorted((name, size) for name, size in used.items() if name.startswith(kind + "."))

        def outputs(name: str, *fields: str) -> list[tuple[str, int]]:
            found = {field: len(out.nodes) for field, out in functions[name].outputs.items()}
            return [(field, found[field]) for field in fields or found if field in found]

        layout, row = Layout(), "held row" if self.held else "row"
        layout.record("node", NODES, inputs("node"))
        layout.record("element", ELEMENTS, inputs("element"))
        constants = ("total", "longest", "exact", "tolerance", "least")
        layout.record("common", ONE, [*inputs("common"), *((name, 1) for name in constants)])
        layout.record("state", NODES, outputs("finish 0", *NODE))
        layout.record("unknown", NODES, outputs("predictor 0"))
        for name in ("stress", "start_stress"):
            layout.record(name, ELEMENTS, [("stress", k)])
        hoisted = [len(functions[f"before node {i}"].outputs[HOISTED].nodes) for i in range(len(self.kinds))]
        layout.record("before node", NODES, [(HOISTED, max(hoisted))])
        layout.record("before element", ELEMENTS, outputs("before element"))
        layout.record("at_node", ONE, outputs("node 0"))
        layout.record("at_element", ONE, outputs("element", "force", "moment", "strain", "left_strain"))
        both = [(name[2:], size) for name, size in outputs("element") if name.startswith("i.") and name[2:] in SIDES]
        layout.record("left", TWO, [*both, ("L", w * w)])
        layout.record("right", ONE, [*both, ("U", w * w)])
        layout.record("row", NODES, outputs(row, "ahead", "y"))
        layout.record("at_row", ONE, outputs(row, "force", "moment", "left_force", "left_moment", "rows", "asked"))
        layout.record("strain_law", ELEMENTS, outputs("element", "gap", "E"))
        layout.record("move", MOVES, [("move", w)])
        layout.record("nothing", ONE, [("zeros", layout.records["left"].size + w * w)])
        layout.record("change", ONE, [*outputs("finish 0"), *outputs("update 0"), ("stress", k), ("cosine", 1)])
        layout.record("sample", ONE, [(name, 1) for name in SAMPLE])
        layout.record("judged", ONE, outputs("judge"))
        layout.record("sums", ONE, [(name, 1) for name in SUMS])
        if self.held:
            layout.record("free", NODES, [("free", w)])
            layout.record("support", SUPPORTS, [*outputs(row, "rows", "asked"), *((name, w) for name in (
                "reaction", "found", "last"))])
        return layout


class _Tracing:
    """Traces with the shapes of the fields at hand; those of what functions hand over to each other are its outputs'."""

    def __init__(self, local: LocalFunctions, kinds: tuple[NodeKind, ...], held: bool) -> None:
        self.local, self.kinds, self.held = local, kinds, held
        self.like = local.model.length.detach()
        space = local.model.space
        p, s, k = space.position, space.spin, space.strain
        q = space.identity(self.like.new_zeros(p)).shape[-1]
        self.shapes = {"position": (p,), "rotation": (q,), "velocity": (p,), "spin": (s,), "u": (p,), "m": (q,), "stress": (k,)}
        trees = (("node", local.nodes, 1), ("element", local.elements, 1), ("common", local.common, 0))
        self.constants = {kind: {f"{kind}.{i}": tuple(x.shape[x.ndim - axes + rows:])
                                 for i, (x, axes) in enumerate(flattened(tree))} for kind, tree, rows in trees}

    def functions(self) -> dict[str, Function]:
        local, constants, shapes = self.local, self.constants, self.shapes
        w = local.model.space.unknowns
        common, element = constants["common"], {**constants["element"], **constants["common"]}
        start = {name: shapes[name] for name in NODE}
        still = {**constants["node"], **common, **start}
        node = {**still, "u": shapes["u"], "m": shapes["m"]}
        both = {**element, "stress": shapes["stress"],
                **{f"{side}.{name}": shape for side in "ij" for name, shape in node.items() if name not in common}}
        found = {"cosine": self._traced(local.cosine, {"m": shapes["m"]})}
        for k, kind in enumerate(self.kinds):
            self._split(found, f"node {k}", self._traced(partial(local.node, kind), node), ("u", "m"))
            found[f"predictor {k}"] = self._traced(partial(local.predictor, kind), still)
            found[f"update {k}"] = self._traced(partial(local.update, kind), {**node, "move": (w,)})
            found[f"finish {k}"] = self._traced(partial(local.finish, kind), node)
        whole = self._traced(local.element, both)
        self._split(found, "element", whole, ("i.u", "i.m", "j.u", "j.m", "stress"))
        law = {name: whole.outputs[name].shape for name in ("gap", "E")}
        moves = {"move_i": (w,), "move_j": (w,)}
        found["stress"] = self._traced(local.stress, {**element, **law, **moves, "stress": shapes["stress"]})
        sides = {"left": ("j", "L"), "right": ("i", "U")}
        row = {f"own.{name}": out.shape for name, out in found["node 0"].outputs.items()}
        for side, (end, block) in sides.items():
            row |= {f"{side}.{name[2:]}": out.shape for name, out in whole.outputs.items() if name.startswith(f"{end}.")}
            row[f"{side}.{block}"] = (w, w)
        row |= {"ahead": (w, w), "y": (w,)}
        found["row"] = self._traced(partial(local.row, False), row)
        found["back"] = self._traced(local.back, {"ahead": (w, w), "y": (w,), "next": (w,)})
        if self.held:
            free = {f"free_{name}": (w,) for name in ("before", "here", "after")}
            found["held row"] = self._traced(partial(local.row, True), row | free)
            found["reaction"] = self._traced(local.reaction, {
                "rows": (w, 3 * w), **{name: (w,) for name in ("asked", "free", "before", "here", "after")}})
        found["judge"] = self._traced(local.judge, {name: () for name in (
            *SUMS, "total", "longest", "exact", "tolerance", "before", "over", "done", "status", "iterations")})
        found["outcome"] = self._traced(local.outcome, {name: () for name in (
            "moving", "done", "status", "before", "cosine", "least")})
        return found

    def _traced(self, function: Callable, shapes: dict[str, tuple[int, ...]]) -> Function:
        generator = torch.Generator().manual_seed(0)
        given = {name: torch.rand(shape, generator=generator, dtype=self.like.dtype) for name, shape in shapes.items()}
        found = trace(function, given)
        return found.only(found.outputs)

    def _split(self, found: dict[str, Function], name: str, function: Function, unknown: tuple[str, ...]) -> None:
        before, rest = split(function, [field for field in function.inputs if field not in unknown])
        found[f"before {name}"], found[name] = before.only(before.outputs), rest


@cache
def vector_bytes() -> int:
    """Of a register of this processor."""
    import llvmlite.binding as binding

    features = binding.get_host_cpu_features()
    return 64 if features.get("avx512f") else 32 if features.get("avx") else 16


PROGRAMS: dict[tuple, Program] = {}  # by structure
KEPT = 64  # of them; the oldest goes first


def program_of(local: LocalFunctions, kinds: tuple[NodeKind, ...], held: bool) -> Program:
    """The program of a structure, that of an earlier scene if there was one."""
    key = structure(local, kinds, held)
    if key not in PROGRAMS:
        if len(PROGRAMS) >= KEPT:
            del PROGRAMS[next(iter(PROGRAMS))]
        PROGRAMS[key] = Program(local, kinds, held)
    return PROGRAMS[key]


def structure(local: LocalFunctions, kinds: tuple[NodeKind, ...], held: bool) -> tuple:
    """What the program of a step depends on; never the values of tensors, nor how many elements there are."""
    model = local.model
    space = model.space
    plane = (space.name, tuple(space.section.flatten().tolist())) if isinstance(space, Plane) else None
    return (type(space), plane, model.length.dtype, model.scene.beam.offset, bool(model.scene.loads), kinds, held,
            *(_static(_shapes(tree, rows)) for tree, rows in ((local.nodes, 1), (local.elements, 1), (local.common, 0))))


def _shapes(tree: Any, rows: int) -> Any:
    return map_leaves(lambda x, axes: x.shape[x.ndim - axes + rows:] if isinstance(x, Tensor) else x, tree)


def _static(x: Any) -> Any:
    """What a tree holds, as something that can be a key."""
    if isinstance(x, Tree):
        return type(x), tuple((name, value is None if name == "node" else _static(value)) for name, value in vars(x).items()
                              if not cache_of(x, name))
    if isinstance(x, dict):
        return tuple((name, _static(value)) for name, value in x.items())
    return tuple(map(_static, x)) if isinstance(x, (tuple, list)) else x
