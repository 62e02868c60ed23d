"""Designs: where samples lie. Point i is a function of the design and i alone, whoever asks."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .joint_law import JointLaw

SOBOL_POINTS = 2**30  # of one sequence


@dataclass(frozen=True)
class Sobol:
    """Sobol sequences, scrambled by random lower triangular matrices and a digital shift (Matousek
    1998, as torch has it), one after the other: `points` of the first, as many of the second ...

    dimension  of a point;  seed of the first sequence: those of the others follow from it
    points     of each sequence; None = there is one
    """

    dimension: int
    seed: int
    points: int | None = None

    independent = False

    def uniform(self, first: int, last: int) -> Tensor:
        """Points first to last - 1, (last - first, dimension) float64 in (0, 1)."""
        if self.points is None:
            return sobol(self.dimension, self.seed, first, last)
        parts = []
        while first < last:
            k, begin = divmod(first, self.points)
            end = min(self.points, begin + last - first)
            parts.append(sobol(self.dimension, replicate_seed(self.seed, k), begin, end))
            first += end - begin
        return torch.cat(parts)

    def theta(self, joint: JointLaw, first: int, last: int) -> Tensor:
        return joint.of_uniform(self.uniform(first, last))

    def part(self, first: int, last: int) -> Sobol:
        """What of the design is needed for these points."""
        return self

    @property
    def label(self) -> dict[str, Any]:
        """What a folder is known by, beside the seed."""
        start = sobol(max(self.dimension, 1), self.seed, 0, 4)[:, : self.dimension].tolist()
        return {"sobol": start, **({} if self.points is None else {"points": self.points})}


@dataclass(frozen=True)
class Plain:
    """Independent points, by a counter-based generator (Philox; Salmon et al. 2011): no two chunks
    share a stream.
    """

    dimension: int
    seed: int
    points: int | None = None

    independent = True

    def uniform(self, first: int, last: int) -> Tensor:
        blocks = max(-(-self.dimension // 4), 1)  # the generator counts by four numbers
        bits = np.random.Philox(key=self.seed)
        bits.advance(first * blocks)
        raw = bits.random_raw((last - first) * 4 * blocks).reshape(last - first, -1)[
            :, : self.dimension
        ]
        return torch.from_numpy(((raw >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53)

    theta, part = Sobol.theta, Sobol.part

    @property
    def label(self) -> dict[str, Any]:
        return {"design": "plain", "first": self.uniform(0, 1).tolist()}


@dataclass(frozen=True)
class Given:
    """A user's samples, as independent: theta (n, columns); `offset`, number of its first row."""

    values: Tensor
    offset: int = 0

    independent = True
    points = None

    def theta(self, joint: JointLaw, first: int, last: int) -> Tensor:
        return self.values[first - self.offset : last - self.offset]

    def part(self, first: int, last: int) -> Given:
        return replace(
            self, values=self.values[first - self.offset : last - self.offset].clone(), offset=first
        )

    @property
    def label(self) -> dict[str, Any]:
        return {
            "design": "given",
            "theta": hashlib.sha256(self.values.contiguous().numpy().tobytes()).hexdigest(),
        }


@dataclass(frozen=True)
class Scores(Given):
    """Samples at given normal scores: values (n, dimension)."""

    def theta(self, joint: JointLaw, first: int, last: int) -> Tensor:
        return joint.of_score(super().theta(joint, first, last))


@dataclass(frozen=True)
class Exchanged:
    """Samples in groups of `parts` + 2: one of A, one of B, and A with one part exchanged for B's,
    for each part in turn. (Saltelli et al. 2010.) A and B are halves of the points of `base`, whose
    dimension is twice that of the laws.

    parts  (parts, dimension) which variates belong to which part
    """

    base: Sobol | Plain
    parts: Tensor

    independent = False
    points = None

    def theta(self, joint: JointLaw, first: int, last: int) -> Tensor:
        size = len(self.parts) + 2
        begin, end = first // size, -(-last // size)
        A, B = self.base.uniform(begin, end).chunk(2, -1)
        exchanged = torch.where(self.parts[:, None], B, A)
        rows = torch.cat((A[None], B[None], exchanged)).transpose(0, 1).flatten(0, 1)
        return joint.of_uniform(rows[first - begin * size : last - begin * size])

    def part(self, first: int, last: int) -> Exchanged:
        return self

    @property
    def label(self) -> dict[str, Any]:
        return {
            "design": "exchanged",
            **{f"base {key}": value for key, value in self.base.label.items()},
        }


def replicate_seed(seed: int, k: int) -> int:
    """Seed of the k-th sequence: that of the first is the seed itself."""
    return (
        seed
        if k == 0
        else int.from_bytes(hashlib.sha256(f"{seed} {k}".encode()).digest()[:8], "big") >> 1
    )


def sobol(dimension: int, seed: int, first: int, last: int) -> Tensor:
    """Points first to last - 1 of scrambled Sobol, (last - first, dimension) float64 in (0, 1)."""
    engine = torch.quasirandom.SobolEngine(max(dimension, 1), scramble=True, seed=seed)
    # the engine itself walks to the point before, one by one; each bit of its Gray code is an
    # exclusive or
    if first:
        gray = first - 1 ^ first - 1 >> 1
        for bit in range(gray.bit_length()):
            if gray >> bit & 1:
                engine.quasi ^= engine.sobolstate[:, bit]
        engine.num_generated = first
    # the engine itself keeps its first point in the default dtype
    start = engine.quasi.double() / 2**engine.MAXBIT
    u = engine.draw(last - first, dtype=torch.float64)
    u = torch.cat((start[None], u[1:])) if first == 0 else u
    return (u + 2.0**-31)[:, :dimension]  # multiples of 2^-30: now never 0, and never 1
