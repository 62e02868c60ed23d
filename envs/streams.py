"""Streams: a generator of random numbers for each sub-env."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding


class Streams:
    """Generators of `count` sub-envs, made where they are first wanted, and the seeds that they were made from."""

    def __init__(self, count: int) -> None:
        self.count = count
        self.generators: list[np.random.Generator] = []
        self.seeds: list[int] = []

    def seed(self, seed: Any, mask: Any) -> None:
        """Seed the streams in the mask (n,): s gives sub-env i the seed s + i, a list one each; None goes on with those there
        are. Raises ValueError for what is no seed.
        """
        one = isinstance(seed, (int, np.integer)) and not isinstance(seed, bool)
        each = [None if seed is None else int(seed) + i for i in range(self.count)] if seed is None or one else seed
        if not isinstance(each, (Sequence, np.ndarray)) or isinstance(each, str) or any(not _is_seed(s) for s in each):
            raise ValueError(f"seed = {seed!r} was given; a whole number from 0, one for each sub-env, or None is wanted")
        if len(each) != self.count:
            raise ValueError(f"{len(each)} seeds were given; {self.count} are wanted, one for each sub-env")
        if not self.generators:
            self.generators, self.seeds = map(list, zip(*(seeding.np_random() for _ in each), strict=True))
        for i, own in enumerate(each):
            if own is not None and mask[i]:
                self.generators[i], self.seeds[i] = seeding.np_random(int(own))


def _is_seed(seed: Any) -> bool:
    return seed is None or (isinstance(seed, (int, np.integer)) and not isinstance(seed, bool) and seed >= 0)
