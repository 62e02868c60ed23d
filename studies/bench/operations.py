"""Operations: how many numbers the traced functions compute, and how many tensor operations a step
is. They are the same on every machine, so that growth is found without a clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import torch

from studies.operations import operations as tensor_operations
from torchbeam import Stepper
from torchbeam.core.measurement import Measured

from ..common_case import SPACES, Case
from .structures import loop

PART, UNIT = "operations", "operations"
Counts = dict[str, int]  # by name: space, what


def counts() -> Counts:
    """Of the common dynamic case: of each traced function for a sample, the whole of an element, a
    node and a row in one iteration and in the adjoint; tensor operations of a call of `Stepper`, at
    batch 1 and in motion. Traced functions of a structure.
    """
    case, operations = Case.load(), {}
    for space, plane in SPACES.items():
        EI = case.t.new_tensor(1.0, requires_grad=True)
        force = case.t.new_tensor((0.0, 1.0, 0.0), requires_grad=True)
        scene = case.scene(4, plane, EI, force)
        steppers = {
            engine: Stepper(scene, 0.005, engine=engine) for engine in ("eager", "compiled")
        }
        stepper = steppers["compiled"]
        program = stepper.compiled.program
        # those of other scenes are of other constants
        known, program.adjoints = program.adjoints, {}
        stepper.compiled.structure.adjoints.clear()
        state = stepper(stepper.rest())
        state.tip.position.sum().backward()
        (adjoint,) = program.adjoints.values()
        program.adjoints = known | program.adjoints
        state = state.detach()
        with torch.no_grad():
            for engine, stepper in steppers.items():
                stepper(state)  # what it keeps is made
                operations[f"{space}: {engine} step, tensor operations"] = tensor_operations(
                    partial(stepper, state)
                )
        for kind, one in {"step": program, "adjoint": adjoint}.items():
            operations |= {
                f"{space}: {kind}, {name}": function.operations()
                for name, function in one.functions.items()
            }
    program = Stepper(loop(), 0.005, engine="compiled").compiled.program
    return operations | {
        f"structure: step, {name}": function.operations()
        for name, function in program.functions.items()
    }


def rows(quick: bool) -> Iterator[Measured]:
    for name, count in counts().items():
        space, _, what = name.partition(": ")
        yield Measured.of(PART, what, count, UNIT, space=space)
