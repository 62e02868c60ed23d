"""Laws with memory in joints, of all joints of a scene at once, see `scene.hysteresis`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf, with_values
from ..scene.hysteresis import HystereticLaw, Response


@dataclass(frozen=True)
class JointHysteresis(Tree):
    """laws: one of each class, its numbers those of all joints (..., J); there (J, laws) 1 where a
    joint has it, else 0, and its numbers are any.
    """

    laws: tuple[HystereticLaw, ...]
    there: Tensor = leaf(2)

    @property
    def memory(self) -> int:
        """How many numbers a joint keeps."""
        return max(law.memory for law in self.laws)

    @property
    def kinds(self) -> list[int | None]:
        """Of each joint the number of its law, None = it has none."""
        return [row.index(1.0) if 1.0 in row else None for row in self.there.tolist()]

    def response(self, before: Tensor, after: Tensor, memory: Tensor, moves: bool) -> Response:
        """Of coordinates (..., J) before and after, with (..., J, memory) before."""
        total = None
        for k, law in enumerate(self.laws):
            there = self.there[:, k]
            part = law.response(before, after, memory[..., : law.memory], moves)
            kept = pad(there[:, None] * part.memory, (0, memory.shape[-1] - law.memory))
            part = Response(there * part.load, there * part.slope, kept)
            total = (
                part
                if total is None
                else Response(*(a + b for a, b in zip(total, part, strict=True)))
            )
        return total

    def alone(self, k: int | None) -> JointHysteresis | None:
        """That of one joint with the k-th law; None = it has none."""
        if k is None:
            return None
        return JointHysteresis((self.laws[k],), torch.ones_like(self.there[:, :1]).detach())


def hysteresis_of(joints: tuple[Any, ...], like: Tensor) -> JointHysteresis | None:
    """Of the joints of a scene; None where none has such a law."""
    kinds = list(dict.fromkeys(type(x.hysteresis) for x in joints if x.hysteresis is not None))
    if not kinds:
        return None
    laws, there = [], []
    for kind in kinds:
        own = [x.hysteresis if type(x.hysteresis) is kind else None for x in joints]
        some = next(law for law in own if law is not None)
        each = [some if law is None else law for law in own]
        numbers = {
            field.name: torch.stack(
                torch.broadcast_tensors(*(getattr(law, field.name) for law in each)), -1
            )
            for field in fields(kind)
        }
        laws.append(with_values(some, **numbers, rows=1))
        there.append([float(law is not None) for law in own])
    return JointHysteresis(tuple(laws), like.new_tensor(there).mT)
