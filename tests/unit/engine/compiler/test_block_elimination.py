"""Sparse systems of blocks, each lane by itself, against torch.linalg."""

import ctypes
from itertools import chain

import pytest
import torch

from torchbeam.engine.compiler.block_elimination import BlockElimination
from torchbeam.engine.compiler.block_pattern import BlockPattern
from torchbeam.engine.compiler.library import Library
from torchbeam.engine.compiler.llvm import Lanes, Module
from torchbeam.engine.compiler.loop_text import Code

# units 0 and 3 of a loop 0 - 1 - 2 - 3 - 4 - 0 with a chord are eliminated in groups, 5 hangs on 2
COUPLINGS = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 0), (1, 3), (2, 5)]
GROUPS = [(5,), (0, 4), (3,), (1, 2)]


def both(couplings):
    return [pair for i, j in couplings for pair in ((i, j), (j, i))]


BLOCKS = [*both(COUPLINGS), (5, 3), (2, 0)]  # two of them in one direction alone


def library(lanes, dtype, w):
    module = Module(lanes, dtype)
    module.added += BlockElimination(Lanes(lanes, dtype), w).functions()
    system = "ptr %memory", "ptr %flags"
    for name in ("clear", "eliminate", "substitute"):
        code = Code(f"run {name}", [*system, "ptr %table", "i64 %groups"])
        code.line(f'call void @"{name}"({", ".join(code.given)})')
        module.added.append(code.text())
    given = *system, "i64 %first", "i64 %stride", "ptr %source"
    code = Code("run add_block", given)
    code.line(f'call void @"add_block"({", ".join(given)})')
    module.added.append(code.text())
    return Library(module.text())


def solved(pattern, A, b, dtype, blocks=BLOCKS):
    """A (lanes, units, units, w, w), b (lanes, units, w)"""
    lanes, units, w = b.shape
    own = library(lanes, dtype, w)
    memory = torch.full((pattern.size, lanes), torch.nan, dtype=dtype)  # what no block is put to
    flags = torch.full((pattern.size,), 7, dtype=torch.uint8)
    system = memory.data_ptr(), flags.data_ptr()
    tables = [[*chain(*own)] for own in (pattern.elimination, pattern.substitution)]
    tables = [(ctypes.c_int64 * len(x))(*map(int, x)) for x in tables]

    def run(name, *given):
        kinds = [ctypes.c_void_p] * 2 + [ctypes.c_int64] * 2 + [ctypes.c_void_p]
        if len(given) == 2:
            kinds = [ctypes.c_void_p] * 3 + [ctypes.c_int64]
        ctypes.CFUNCTYPE(None, *kinds)(own.address(f"run {name}"))(*system, *given)

    run("clear", ctypes.addressof(tables[0]), len(pattern.groups))
    for i, j in [*blocks, *((k, k) for k in range(units))]:
        if not A[:, i, j].any():
            continue  # it is not there
        for part in (0.25, 0.75):
            block = (part * A[:, i, j]).movedim(0, -1).contiguous()
            run("add_block", *pattern.place(i, j), block.data_ptr())
    for i in range(units):
        place = pattern.right(i)
        for k in range(w):
            memory[place.first + k * place.stride] = b[:, i, k]
    for name, table in zip(("eliminate", "substitute"), tables, strict=True):
        run(name, ctypes.addressof(table), len(pattern.groups))
    at = [pattern.solution(unit) for unit in range(units)]
    return torch.stack([memory[first : first + w].T for first in at], 1)


@pytest.mark.parametrize(
    "lanes, dtype, w", [(4, torch.float64, 3), (1, torch.float64, 2), (8, torch.float32, 3)]
)
def test_as_torch_solves_it(lanes, dtype, w):
    """Diagonals are zero in places, others in each lane: without exchange of rows, lane by lane,
    there is no solution. Tolerance: 1e3 roundings, of systems of 18 unknowns that are well
    conditioned.
    """
    pattern, units = BlockPattern(w, GROUPS, BLOCKS), 6
    generator = torch.Generator().manual_seed(2)
    A = torch.zeros(lanes, units, units, w, w, dtype=dtype)
    for i, j in BLOCKS:
        A[:, i, j] = torch.randn(lanes, w, w, generator=generator, dtype=dtype)
    for unit in range(units):
        for lane in range(lanes):
            order = torch.randperm(w, generator=generator)
            A[lane, unit, unit] = 6 * torch.eye(w, dtype=dtype)[order]
    b = torch.randn(lanes, units, w, generator=generator, dtype=dtype)
    dense = A.transpose(2, 3).reshape(lanes, units * w, units * w)
    expected = torch.linalg.solve(dense, b.flatten(1)).reshape(b.shape)
    error = (solved(pattern, A, b, dtype) - expected).abs().max() / expected.abs().max()
    assert error < 1e3 * torch.finfo(dtype).eps


def test_a_singular_lane_leaves_others_alone():
    """A lane of zeros has no finite solution; its neighbour's is that of the same lane
    twice, by the same instructions.
    """
    pattern, units, w = BlockPattern(2, [(0, 1)], both([(0, 1)])), 2, 2
    generator = torch.Generator().manual_seed(3)
    A = torch.randn(1, units, units, w, w, generator=generator, dtype=torch.float64)
    b = torch.randn(1, units, w, generator=generator, dtype=torch.float64)
    whole = [torch.cat((x, 0 * x)) for x in (A, b)]
    twice = [torch.cat((x, x)) for x in (A, b)]
    x, y = (solved(pattern, *system, torch.float64, both([(0, 1)])) for system in (whole, twice))
    assert torch.equal(x[0], y[0])
    assert not torch.isfinite(x[1]).any()


def test_blocks_that_are_zero_count_as_those_that_are_not_there():
    """In some lanes, in all of them, or the first of a block's rows alone; one direction of a
    coupling alone.
    """
    lanes, w, units, dtype = 2, 3, 6, torch.float64
    pattern = BlockPattern(w, GROUPS, BLOCKS)
    A = torch.zeros(lanes, units, units, w, w, dtype=dtype)
    generator = torch.Generator().manual_seed(3)
    for i, j in BLOCKS:
        A[:, i, j] = torch.randn(lanes, w, w, generator=generator, dtype=dtype)
    A += 6 * torch.eye(units, dtype=dtype)[:, :, None, None] * torch.eye(w, dtype=dtype)
    A[:, 0, 1] = A[:, 2, 5] = 0
    A[0, 3, 4] = A[1, 4, 3] = 0
    A[:, 1, 3, :2] = 0
    b = torch.randn(lanes, units, w, generator=generator, dtype=dtype)
    expected = torch.linalg.solve(A.transpose(2, 3).reshape(lanes, 18, 18), b.flatten(1))
    error = (solved(pattern, A, b, dtype).flatten(1) - expected).abs().max()
    assert error < 1e3 * torch.finfo(dtype).eps * expected.abs().max()


@pytest.mark.parametrize("lanes", [1, 4])
def test_signs_of_what_constraints_leave(lanes):
    """3 moves with 2 constraints of 3, against eigenvalues of Z^T K Z. K is indefinite, or zero, in
    lanes that are stable; constraints say other moves in each.
    """
    torch.manual_seed(0)
    module, w = Module(lanes, torch.float64), 3
    module.added += BlockElimination(Lanes(lanes, torch.float64), w, signs=True).functions()
    given = "ptr %panel", "i64 %n", "i64 %columns", "i64 %moves", "ptr %own", "ptr %to"
    code = Code("run signs", [*given])
    code.line(f'call void @"signs"({", ".join(given)})')
    module.added.append(code.text())
    library = Library(module.text())
    kinds = [ctypes.c_void_p, *[ctypes.c_int64] * 3, *[ctypes.c_void_p] * 2]
    run, seen = ctypes.CFUNCTYPE(None, *kinds)(library.address("run signs")), set()
    for k in range(40):
        G = torch.randn(lanes, 2, w, dtype=torch.float64)
        G[:, :, k % 3] *= k % 2
        K = torch.randn(lanes, w, w, dtype=torch.float64)
        K = (K + K.mT) * (k % 5 > 0) + 9 * (k % 3 - 1) * G.mT @ G + torch.eye(w) * (k % 4)
        Z = torch.linalg.svd(G).Vh[:, 2:].mT
        panel = torch.zeros(lanes, 2 * w, 2 * w + 1, dtype=torch.float64)
        panel[:, :w, :w], panel[:, w : w + 2, :w], panel[:, :w, w : w + 2] = K, G, G.mT
        panel[:, -1, -2] = 1.0
        numbers, own = panel.movedim(0, -1).contiguous(), torch.zeros(36, lanes, dtype=K.dtype)
        to = torch.zeros(lanes, dtype=K.dtype)
        run(numbers.data_ptr(), 2 * w, 2 * w + 1, w, own.data_ptr(), to.data_ptr())
        unstable = torch.linalg.eigvalsh(Z.mT @ K @ Z).amin(-1) <= 0
        assert (to != 0).tolist() == unstable.tolist(), k
        seen.update(unstable.tolist())
    assert len(seen) == 2
