"""Breakdown of a step: native code, of it assembly, elimination and the rest, and what is around
it.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import prod
from typing import Any

import torch

import torchbeam as tb
from torchbeam.core.measurement import Measured, progress
from torchbeam.engine.chain.native import NativeProgram
from torchbeam.engine.compiler.function import Function
from torchbeam.engine.compiler.library import Library
from torchbeam.engine.compiler.llvm import Module
from torchbeam.engine.compiler.loop_text import Code

from ..common_case import SPACES, Case

PART, STEP, STEPS = "breakdown", 0.005, 400
CALLS = 1000  # of a function by itself
ELEMENTS, BATCHES = {"3D": 10, "plane": 12}, {"3D": (1, 256), "plane": (1, 1024)}
ASSEMBLY = ("element", "node", "before element", "before node")
ELIMINATION = ("row", "held row", "back")
# the others once a step
ITERATED = {"element", "node", "row", "held row", "back", "stress", "update", "reaction", "judge"}
OF_ELEMENTS, OF_SAMPLES = {"element", "before element", "stress"}, {"judge", "outcome"}
OF_SUPPORTS = {"reaction"}
NEAR = 2  # nodes that the clamp holds, or a neighbour of


def rows(quick: bool) -> Iterator[Measured]:
    """CPU microseconds of a step of the whole batch: in all, native, of this what the traced
    functions take by themselves, and the wrapper. What is native beside them is the driver: loops,
    masks, transfers between tensors and memory.
    """
    case, steps = Case.load(), 40 if quick else STEPS
    for space, plane in SPACES.items():
        for batch in BATCHES[space][-1:] if quick else BATCHES[space]:
            N = ELEMENTS[space]
            scene = case.scene(N, plane)
            program = tb.Stepper(scene, STEP, engine="compiled").compiled.program
            start = tb.rest(scene, () if batch == 1 else (batch,))
            t = case.t.new_tensor((0.0, steps * STEP))
            best = float("inf"), 0.0, 0.0
            for _ in range(2 if quick else 4):
                with torch.no_grad(), clocked(program) as clock:
                    begun = time.process_time()
                    solution = tb.simulate(scene, t, start, step=STEP, engine="compiled")
                    seconds = time.process_time() - begun
                best = min(
                    best,
                    (seconds, clock["seconds"], solution.stats.iterations.double().mean().item()),
                )
            whole, native, iterations = best
            lanes = 1 if batch == 1 else program.lanes()
            parts = {
                name: seconds * -(-batch // lanes) * calls(name, N, iterations)
                for name, seconds in by_themselves(program, lanes).items()
            }

            def share(names: tuple[str, ...], parts: dict[str, float] = parts) -> float:
                return sum(s for name, s in parts.items() if name.rstrip(" 0123456789") in names)

            assembly, elimination = share(ASSEMBLY), share(ELIMINATION)
            others = sum(parts.values()) - assembly - elimination
            shares_of = {
                "in all": whole / steps, "wrapper": (whole - native) / steps,
                "native": native / steps, "native: assembly": assembly,
                "native: elimination": elimination, "native: other functions": others,
                "native: driver": native / steps - assembly - elimination - others,
            }  # fmt: skip
            where = dict(
                engine="compiled", space=space, elements=N, step_ms=1e3 * STEP, batch=batch
            )
            for what, seconds in shares_of.items():
                yield Measured.of(PART, what, 1e6 * seconds, "CPU us a step", **where)
            progress(
                f"{space}, batch {batch}: {1e6 * whole / steps:.0f} us a step, "
                f"{1 - native / whole:.0%} of it not native"
            )


def calls(name: str, elements: int, iterations: float) -> float:
    """How often a step calls a function, for each group of samples; the clamp holds the first of
    the nodes.
    """
    base = name.rstrip(" 0123456789")
    held = NEAR if base == "held row" else -NEAR if base == "row" else 0
    count = held if held > 0 else elements + 1 + held
    count = elements if base in OF_ELEMENTS else 1 if base in OF_SAMPLES | OF_SUPPORTS else count
    return count * (iterations if base in ITERATED else 1)


@contextmanager
def clocked(program: NativeProgram) -> Iterator[dict[str, float]]:
    """Adds up the CPU seconds in a program's native code."""
    clock = {"seconds": 0.0}

    def run(*form: int) -> Callable[[Any], None]:
        native = type(program).run(program, *form)

        def timed(arguments: Any) -> None:
            begun = time.process_time()
            native(arguments)
            clock["seconds"] += time.process_time() - begun

        return timed

    program.run = run
    try:
        yield clock
    finally:
        del program.run


def by_themselves(program: NativeProgram, lanes: int) -> dict[str, float]:
    """CPU seconds of a call of each function of a program, for so many lanes, with all that it
    reads in the nearest cache.
    """
    module = Module(lanes, program.dtype)
    for name, function in program.functions.items():
        module.define(name, function)
    for name, function in program.functions.items():
        count = len(function.inputs) + len(function.outputs)
        code = Code(f"repeat {name}", [*(f"ptr %p{k}" for k in range(count)), "i64 %calls"])
        with code.loop(0, "%calls"):
            code.call(name, *(f"%p{k}" for k in range(count)))
        module.added.append(code.text())
    library = Library(module.text())
    return {
        name: _seconds(library, name, function, program.dtype, lanes)
        for name, function in program.functions.items()
    }


def _seconds(
    library: Library, name: str, function: Function, dtype: torch.dtype, lanes: int
) -> float:
    generator = torch.Generator().manual_seed(0)
    sizes = [prod(shape) for shape in function.inputs.values()] + [
        len(out.nodes) for out in function.outputs.values()
    ]
    fields = [torch.rand(size, lanes, generator=generator, dtype=dtype) for size in sizes]
    native = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * len(fields), ctypes.c_int64)(
        library.address(f"repeat {name}")
    )
    best = float("inf")
    for _ in range(5):
        begun = time.process_time()
        native(*(field.data_ptr() for field in fields), CALLS)
        best = min(best, (time.process_time() - begun) / CALLS)
    return best
