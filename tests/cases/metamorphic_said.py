"""A random scene and what is asked of it, for relations to say in two ways."""

from __future__ import annotations

import os
import random
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from unittest.mock import patch

import torch
from torch import Tensor

from tests.cases.gradient_cases import Case, Spec
from tests.cases.metamorphic_answers import ANSWERS, Found, Problem, told
from tests.cases.metamorphic_parts import NotHere

Blocks = dict[str, Tensor]
Pair = tuple[Blocks, Blocks]
SAMPLES = 4  # no other axis is as long


@contextmanager
def engine(name: str) -> Iterator[None]:
    with patch.dict(os.environ, TORCHBEAM_ENGINE=name):
        yield


@dataclass
class Said:
    """A random scene and what is asked of it; x: the tensors that it is made of; seed: of what a
    relation draws.
    """

    spec: Spec
    answer: str
    x: Blocks
    case: Case
    seed: int = 0

    @property
    def random(self) -> random.Random:
        return random.Random(self.spec.seed * 31 + self.seed)

    @cached_property
    def problem(self) -> Problem:
        return Problem.of(self.case, self.x)

    def ask(self, problem: Problem | None = None, answer: str | None = None) -> Found:
        return ANSWERS[answer or self.answer].function(problem or self.problem)

    @cached_property
    def plain(self) -> Blocks:
        return told(self.ask())

    def of(self, x: Blocks) -> Blocks:
        return told(self.ask(Problem.of(self.case, x)))

    def several(self, samples: int = SAMPLES) -> tuple[Blocks, list[Blocks]]:
        """Tensors of several scenes in one batch, but for those that take none; and one by one."""
        scale = 1 + 0.01 * torch.arange(samples)
        return self.scaled(scale), [self.scaled(k) for k in scale]

    def scaled(self, by: Tensor) -> Blocks:
        """Tensors times numbers (...), but for those that take no batch."""
        return {
            n: v if n in self.case.draw.alone else v * by[(...,) + (None,) * v.ndim]
            for n, v in self.x.items()
        }


def wants(said: Said, holds: bool) -> None:
    if not holds:
        raise NotHere
