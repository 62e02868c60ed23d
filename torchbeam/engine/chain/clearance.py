"""Clearance: how long pairs that are not in a list surely stay apart, wherever nodes move to."""

from __future__ import annotations

import ctypes
import threading
from functools import cache
from typing import Any

import torch
from torch import Tensor

from ...math.shapes import broadcast_shapes
from ...nodal.touching import PartContact
from ...nodal.touching_forces import ScenePairs
from ..compiler.ball_distances import ARGS, PLANES, RUN, BallDistances
from ..compiler.library import Library
from ..compiler.llvm import Lanes
from ..compiler.object_cache import ObjectCache
from .native import vector_bytes


class Clearance:
    """Of the places and pieces of a scene that may touch, without those `near`, of each (..., n, K)
    bool by their nodes: see `BallDistances`. What is found out is kept for the next time.
    """

    def __init__(self, touching: ScenePairs, near: list[Tensor], nodes: int) -> None:
        self.nodes, links = nodes, [[*range(nodes)] for _ in range(2)]
        rest: dict[Any, Tensor] = {}
        reach: dict[Any, Tensor] = {}
        for contact, rows in zip(touching.each, near, strict=True):
            points, pieces = contact.nodes
            for before, node, after in (*points, *pieces):
                links[0][node], links[1][node] = before, after
            # from one of two beams to the other and back nodes are as far from each other
            reach[contact.pair] = contact.reach
            pairs = self._between(contact, contact.may_touch & ~rows)
            rest[contact.pair] = pairs | rest.get(contact.pair, False)
        self._links = torch.tensor(links)
        self._reach = [*reach.values()]
        self._runs, self._first, self._counts = self._tables([*rest.values()])
        self._batch = broadcast_shapes(self._first.shape, *(x.shape for x in self._reach))
        self._shape: tuple[int, ...] | None = None
        self._numbers = (ctypes.c_int64 * len(ARGS))()
        self._lock = threading.Lock()  # of what is kept

    def _between(self, contact: PartContact, pairs: Tensor) -> Tensor:
        """(..., nodes, nodes) of pairs (..., n, K), each once."""
        points, pieces = (torch.tensor([node[1] for node in part]) for part in contact.nodes)
        every = pairs.new_zeros(*pairs.shape[:-2], self.nodes, self.nodes)
        every[..., points[:, None], pieces] = pairs
        return (every | every.mT).triu()

    def _tables(self, rest: list[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Runs (R, 4); of each sample, or of all, the number of its first, and how many."""
        shape = broadcast_shapes(*(x.shape[:-2] for x in rest))
        runs, counts = [], []
        parts = [x.expand(*shape, *x.shape[-2:]).reshape(-1, *x.shape[-2:]) for x in rest]
        if shape and all((x == x[:1]).all() for x in parts):
            shape, parts = torch.Size(()), [x[:1] for x in parts]
        for b in range(shape.numel()):
            found = []
            for kind, x in enumerate(parts):
                change = torch.nn.functional.pad(x[b].to(torch.int8), (1, 1)).diff(dim=-1)
                (node, first), (_, end) = ((change == k).nonzero().unbind(-1) for k in (1, -1))
                found.append(torch.stack((node, first, end, torch.full_like(node, kind)), -1))
            runs.append(torch.cat(found))
            counts.append(len(runs[-1]))
        counts = torch.tensor(counts)
        first = counts.cumsum(0) - counts
        return torch.cat(runs).contiguous(), first.view(shape), counts.view(shape)

    def _shaped(self, position: Tensor) -> None:
        """Memory for samples (..., nodes, 3)."""
        if position.shape == self._shape:
            return
        batch, dtype = position.shape[:-2], position.dtype
        self._shape, samples = position.shape, batch.numel()
        first = 2 * samples + RUN * self._first  # in integers, behind those of all samples
        bounds = torch.stack([x.expand(batch) for x in (first, self._counts)], -1)
        self._table = torch.cat((bounds.flatten(), self._runs.flatten()))
        reach = torch.stack([x.expand(batch) for x in self._reach], -1)
        self._reaches = reach.to(dtype).contiguous()
        lanes = _lanes(dtype)
        self._scratch = torch.empty(PLANES, self.nodes + lanes, dtype=dtype)
        self._known = position.detach().clone(memory_format=torch.contiguous_format)
        self._room = torch.full((samples,), -1.0, dtype=dtype)
        for name, x in (
            ("before", self._links[0]),
            ("after", self._links[1]),
            ("runs", self._table),
            ("reach", self._reaches),
            ("scratch", self._scratch),
            ("known", self._known),
            ("room", self._room),
        ):
            self._set(name, x.data_ptr())
        self._set("samples", samples)
        self._set("nodes", self.nodes)
        self._set("kinds", len(self._reach))

    def _set(self, name: str, value: int) -> None:
        self._numbers[ARGS.index(name)] = value

    def _call(self, name: str, start: Tensor, moved: Tensor, steps: int, result: Any) -> Any:
        with self._lock:
            self._shaped(start)
            self._set("steps", steps)
            self._set("start", start.data_ptr())
            self._set("moved", moved.data_ptr())
            self._set("result", ctypes.addressof(result))
            _functions(start.dtype)[name](self._numbers)
        return result.value

    def within(self, start: Tensor, moved: Tensor | None = None) -> int:
        """Of the steps from start (..., nodes, 3) to the places moved (K, ..., nodes, 3) how many,
        from the first on, surely leave all pairs apart; -1 = they are not apart at the start.
        """
        start, steps = self._of_all(start), 0 if moved is None else len(moved)
        moved = start if moved is None else moved.contiguous()
        return self._call("within", start, moved, steps, ctypes.c_int64())

    def approach(self, position: Tensor, velocity: Tensor) -> float:
        """The least time, s, in which one of the pairs meets with velocities (..., nodes, 3) m/s;
        inf = none does.
        """
        kind = ctypes.c_double if position.dtype == torch.float64 else ctypes.c_float
        position = self._of_all(position)
        velocity = velocity.expand_as(position).contiguous()
        return self._call("approach", position, velocity, 0, kind())

    def _of_all(self, x: Tensor) -> Tensor:
        """Of one place, or of the same in all samples, those of each."""
        if self._batch and self._batch != x.shape[:-2]:
            x = x.expand(*broadcast_shapes(self._batch, x.shape[:-2]), *x.shape[-2:])
        return x.contiguous()


def _lanes(dtype: torch.dtype) -> int:
    return vector_bytes() // torch.empty((), dtype=dtype).element_size()


@cache
def _functions(dtype: torch.dtype) -> dict[str, Any]:
    library = Library(BallDistances(Lanes(_lanes(dtype), dtype)).text(), ObjectCache())
    kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
    functions = {name: kind(library.address(name)) for name in ("within", "approach")}
    return functions | {"library": library}
