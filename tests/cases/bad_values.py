"""Values that an argument cannot be, or may not: at random, and good ones with one thing in them
bad.
"""

import math
from pathlib import Path
from random import Random

import numpy as np
import torch

import torchbeam as tb
from tests.cases.public_calls import BEAM, HUB, MODES, OTHER, SCENE, SECTION, SOLUTION, START


class Hostile:
    """What asks it for its numbers fails."""

    def __len__(self):
        raise RuntimeError("of a hostile object")

    def __array__(self, *a, **k):
        raise RuntimeError("of a hostile object")


NUMBERS = [
    None, True, math.nan, math.inf, -math.inf, -1, 0, 1, 2.5, 9, 10**400, -(10**400), 10**18, 2**31,
    1e308, 1e-320, 1j,
]  # fmt: skip
TEXTS = ["", "x", "x" * 5000, "\0", "\ud800", b"x", Path("nothing/here")]
PLAIN = [
    [], (), {}, {1.0}, [None], [None] * 3, [[]], [[1.0], [1.0, 2.0]], ["x"] * 3, [math.nan] * 3,
    {"a": 1}, {1: 2}, {None: None}, range(3), tb.Scene, math, lambda: None, lambda *a, **k: None,
    lambda *a, **k: "x", ..., slice(None), NotImplemented, Hostile(), (-1, -1), ("arm", 9),
    ("nosuch", 0), torch.float32, torch.device("cpu"), torch.Size([2, 3]),
]  # fmt: skip
ARRAYS = [
    np.array([None, 1], dtype=object), np.array([1.0, "a", None], dtype=object), np.array(["a"]),
    np.array(math.nan), np.zeros((0, 3)), np.datetime64("2020-01-01"), np.ones(3), np.ones(7),
    np.eye(3), np.bool_(True), np.int64(1), np.zeros(2, dtype=[("a", float)]),
    np.ma.masked_array([1.0, 2.0, 3.0], mask=[0, 1, 0]),
]  # fmt: skip
SINGLE = torch.ones(3, dtype=torch.float32)
TENSORS = [
    torch.ones(3, device="meta"), torch.ones(3).to_sparse(), torch.ones(3, dtype=torch.long),
    torch.tensor([True, False, True]), torch.ones(3) * 1j, torch.ones(3).half(), SINGLE,
    torch.ones(3).bfloat16(), torch.full((3,), math.nan), torch.full((3,), math.inf),
    torch.ones(0), torch.ones(0, 3), torch.ones(5), torch.ones(2, 3), torch.ones(3, 2),
    torch.ones(2, 2, 2, 3), torch.tensor(1.0), torch.tensor(1), torch.tensor(-1.0), torch.ones(1),
    torch.ones(3, dtype=torch.uint8), torch.quantize_per_tensor(SINGLE, 0.1, 0, torch.quint8),
    SINGLE.to(torch.float8_e4m3fn), torch.ones(3, requires_grad=True), torch.eye(6),
]  # fmt: skip
OBJECTS = [
    BEAM, SCENE, SECTION, START, SOLUTION, MODES, HUB, tb.rest(OTHER), tb.Input("zz", 3),
    tb.sensors.TipPosition(), tb.TipLoad(force=(0, 0, 1.0)), tb.Parameter(1.0),
    tb.laws.Normal(0.0, 1.0), tb.PerElement(torch.ones(2, 3)),
]  # fmt: skip
VALUES = [*NUMBERS, *TEXTS, *PLAIN, *ARRAYS, *TENSORS, *OBJECTS]


def bad(random: Random):
    """Any of these, or a generator, which is spent by who asks it."""
    k = random.randrange(len(VALUES) + 1)
    return VALUES[k] if k < len(VALUES) else (x for x in (1.0, 2.0))


def spoilt(value, random: Random):
    """A good value with one thing in it bad: an entry, a key, the shape, the sign, the kind."""
    if isinstance(value, (list, tuple)) and value and type(value) in (list, tuple):
        new, k, how = list(value), random.randrange(len(value)), random.randrange(4)
        if how == 3:
            del new[k]
        else:
            new[k : k + (how < 2)] = [spoilt(new[k], random) if how == 0 else bad(random)]
        return type(value)(new)
    if isinstance(value, dict):
        new, how = dict(value), random.randrange(3)
        key = random.choice([*new, "nosuch"])
        if how == 2 or key not in new:
            new[random.choice(["nosuch", 1, None, "", ("a", 1)])] = bad(random)
        elif how == 1:
            del new[key]
        else:
            new[key] = spoilt(new[key], random)
        return new
    if isinstance(value, torch.Tensor) and value.numel() and value.is_floating_point():
        one = value.detach().clone()
        one.view(-1)[random.randrange(one.numel())] = random.choice([math.nan, math.inf, -1, 1e308])
        one_more = value.expand(2, *value.shape)
        return random.choice([one, one_more, value[..., None], one_more[:0], value.float()])
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        two = torch.full((2,), float(value))
        return random.choice([
            -value, value + 0.5, str(value), [value], two[0], np.float32(value), value * 1e300,
            complex(value), two[:0], two, two * torch.tensor([1.0, math.nan]), (value, value),
        ])  # fmt: skip
    if isinstance(value, str):
        return random.choice([value.upper(), f"{value} ", value.encode(), [value], value * 2, ""])
    return bad(random)
