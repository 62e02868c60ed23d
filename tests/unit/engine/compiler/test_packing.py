"""Packing: fields come through without what is zero, equal, or but of another sign."""

import pytest
import torch
from torch.testing import assert_close

from tests.cases.evaluate import evaluate
from torchbeam.engine.compiler.packing import Packing
from torchbeam.engine.compiler.trace import trace


def maker(x):
    """Of nine numbers of A and b three are different ones: x, 0, and the difference."""
    zero = torch.zeros_like(x[0])
    first = torch.stack((x[0].sin(), zero, x[0] - x[1]))
    second = torch.stack((-x[0].sin(), x[1] - x[0], zero))
    return {"A": torch.stack((first, second)), "b": -first, "kept": x}


def unlike(x):
    """What is equal, or zero, in `maker` alone is not packed away."""
    found = maker(x)
    return found | {"b": torch.stack((x[0], x[1].cos(), x[1]))}


def reader(**x):
    return {
        "sum": x["left.A"].sum(0) + x["right.b"],
        "product": x["left.A"] @ x["right.b"] + x["left.b"][:2],
    }


@pytest.mark.parametrize(
    ("makers", "size"), [([maker], 2), ([maker, unlike], 5), ([unlike, maker], 5)]
)
def test_what_is_handed_over_is_small_and_whole(makers, size):
    torch.manual_seed(0)
    x = torch.randn(2, 4, 2, dtype=torch.float64)
    traced = [trace(f, {"x": torch.rand(2)}) for f in makers]
    packing = Packing("packed", traced, ("A", "b"))
    assert packing.size == size
    names = {f"{side}.{name}": name for side in ("left", "right") for name in ("A", "b")}
    whole = trace(
        reader,
        {called: torch.rand(traced[0].outputs[name].shape) for called, name in names.items()},
    )
    taken = packing.taken(whole, names)
    assert set(taken.inputs) == {"left.packed", "right.packed"}
    for one, made in zip(traced, packing.made(), strict=True):
        fields = [evaluate(one, {"x": part}) for part in x]
        packed = [evaluate(made, {"x": part}) for part in x]
        assert_close(packed[0]["kept"], x[0], rtol=0, atol=0)
        sides = ("left", *fields[:1], *packed[:1]), ("right", *fields[1:], *packed[1:])
        given = {f"{side}.{name}": part[name] for side, part, _ in sides for name in ("A", "b")}
        found = evaluate(taken, {f"{side}.packed": part["packed"] for side, _, part in sides})
        for name, expected in evaluate(whole, {name: given[name] for name in whole.inputs}).items():
            assert_close(found[name], expected, rtol=1e-14, atol=1e-14)


def test_where_there_is_no_maker_all_is_zero():
    packing = Packing("packed", [trace(maker, {"x": torch.rand(2)})], ("A", "b"))
    taken = packing.taken(
        trace(lambda A, b: A @ b - b[:2], {"A": torch.rand(2, 3), "b": torch.rand(3)}),
        {"A": "A", "b": "b"},
    )
    assert not evaluate(taken, {"packed": torch.zeros(packing.size)})["out"].any()
