"""Laws along coordinates that say by themselves what they resist by, of all joints of a scene at
once, see `scene.coordinate_law`.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.leaves import Tree, leaf, with_values
from ..scene.coordinate_law import OwnLaw, Response, Travel
from ..scene.effects.drive import Drive


@dataclass(frozen=True)
class CoordinateLaws(Tree):
    """laws: their numbers are those of all joints (..., J), any where a joint has not this law;
    there (J, laws) 1 where it has it, else 0.
    """

    laws: tuple[OwnLaw, ...]
    there: Tensor = leaf(2)

    @property
    def memory(self) -> int:
        """How many numbers a joint keeps."""
        return max(law.memory for law in self.laws)

    @property
    def kinds(self) -> list[tuple[int, ...]]:
        """Of each joint the numbers of its laws."""
        return [tuple(k for k, there in enumerate(row) if there) for row in self.there.tolist()]

    def response(self, travel: Travel) -> Response:
        """Of all joints."""
        parts = []
        for k, law in enumerate(self.laws):
            there, size = self.there[:, k], self.memory - law.memory
            part = law.response(travel._replace(memory=travel.memory[..., : law.memory]))
            memory = there[:, None] * pad(part.memory, (0, size))
            parts.append((there * part.load, there * part.slope, memory))
        return Response(*map(sum, zip(*parts, strict=True)))

    def damper(self, travel: Travel) -> Tensor | None:
        """(..., J) of all; None = none has one."""
        parts = [(k, law.damper(travel)) for k, law in enumerate(self.laws)]
        parts = [self.there[:, k] * x for k, x in parts if x is not None]
        return sum(parts) if parts else None

    def alone(self, which: tuple[int, ...]) -> CoordinateLaws | None:
        """Those of one joint of a kind; None = it has none."""
        if not which:
            return None
        laws = [self.laws[k] for k in which]
        laws = [with_values(law, at=0) if isinstance(law, Drive) else law for law in laws]
        there = self.there.new_ones(1, len(laws))
        return CoordinateLaws(tuple(laws), there)


def coordinate_laws_of(joints: tuple[Any, ...], like: Tensor) -> CoordinateLaws | None:
    """Of the joints of a scene; None where none has one."""
    laws, there = [], []
    own = [joint.hysteresis for joint in joints]
    for kind in dict.fromkeys(type(law) for law in own if law is not None):
        of_kind = [law if type(law) is kind else None for law in own]
        some = next(law for law in of_kind if law is not None)
        laws.append(_of_all(some, [some if law is None else law for law in of_kind]))
        there.append([float(law is not None) for law in of_kind])
    for k, joint in enumerate(joints):
        if joint.drive is not None:
            law = _of_all(joint.drive, [joint.drive] * len(joints))
            laws.append(with_values(law, at=k))
            there.append([float(j == k) for j in range(len(joints))])
    return CoordinateLaws(tuple(laws), like.new_tensor(there).mT) if laws else None


def _of_all(law: OwnLaw, each: list[OwnLaw]) -> OwnLaw:
    """The law with the numbers (..., J) of each joint's."""

    def stacked(values: list[Any]) -> Any:
        if isinstance(values[0], dict):
            return {name: stacked([x[name] for x in values]) for name in values[0]}
        return torch.stack(torch.broadcast_tensors(*values), -1)

    names = [field.name for field in fields(law) if field.name != "function"]
    numbers = {name: stacked([getattr(x, name) for x in each]) for name in names}
    return with_values(law, **numbers, rows=1)
