"""Streams: a generator of random numbers for each sub-env."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding

from torchbeam.extend import shown


class Streams:
    """Generators of `count` sub-envs, made where they are first wanted, and the seeds that they
    were made from.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.generators: list[np.random.Generator] = []
        self.seeds: list[int] = []

    def made(self) -> Streams:
        """With generators; those that are not there yet are made from seeds of the system."""
        if not self.generators:
            self.generators, self.seeds = map(
                list, zip(*(seeding.np_random() for _ in range(self.count)), strict=True)
            )
        return self

    def put(self, i: int, generator: np.random.Generator) -> None:
        """A generator in the place of sub-env i's; its seed is unknown, -1, as Gymnasium has it."""
        self.made().generators[i], self.seeds[i] = generator, -1

    def seed(self, seed: Any, mask: Any) -> None:
        """Seed the streams in the mask (n,): s gives sub-env i the seed s + i, a list one each;
        None goes on with those there are. Raises ValueError for what is no seed.
        """
        one = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
        each = (
            [None if seed is None else int(seed) + i for i in range(self.count)]
            if seed is None or one
            else seed
        )
        listed = (isinstance(each, Sequence) and not isinstance(each, str)) or (
            isinstance(each, np.ndarray) and each.ndim
        )
        if not listed or any(not _is_seed(s) for s in each):
            raise ValueError(
                f"seed = {shown(seed)} was given; a whole number from 0, one for each sub-env, or "
                "None is wanted"
            )
        if len(each) != self.count:
            raise ValueError(
                f"{len(each)} seeds were given; {self.count} are wanted, one for each sub-env"
            )
        self.made()
        for i, begin in enumerate(each):
            if begin is not None and mask[i]:
                self.generators[i], self.seeds[i] = seeding.np_random(int(begin))


def _is_seed(seed: Any) -> bool:
    return seed is None or (
        isinstance(seed, (int, np.integer)) and not isinstance(seed, bool) and seed >= 0
    )
