"""Ends: what is of one end alone is computed there, and with it the rest gives the whole."""

import torch
from torch.testing import assert_close

from tests.cases.evaluate import evaluate
from torchbeam.engine.compiler.shared_ends import END, share_ends
from torchbeam.engine.compiler.trace import trace

SHAPES = {"i.u": (3,), "i.k": (3,), "j.u": (3,), "j.k": (3,), "common.h": (), "own": (3,)}


def function(**x):
    """Of each end u k and h u are its own; what is of k and h alone does not depend on an
    unknown.
    """
    ends = [
        (x[f"{side}.u"] * x[f"{side}.k"]).sin() + (x["common.h"] * x[f"{side}.u"]).cos()
        for side in "ij"
    ]
    still = x["i.k"].exp() * x["common.h"]
    return {
        "far": (ends[1] - ends[0]) * x["own"] + still,
        "near": torch.where(x["i.u"] < 0, ends[0], x["own"]),
        "end": ends[1],
    }


def other(**x):
    """An end of the other kind, at i, is computed otherwise."""
    return function(**x) | {"far": (x["i.u"].exp() - x["j.u"]) * x["own"]}


def inputs():
    generator = torch.Generator().manual_seed(0)
    return {
        name: torch.randn(5, *shape, generator=generator, dtype=torch.float64)
        for name, shape in SHAPES.items()
    }


def test_ends_and_rests_are_the_wholes():
    """To a rounding: two functions of three ends, of two kinds."""
    kinds = [{"i": "a", "j": "a"}, {"i": "b", "j": "a"}]
    given = inputs()
    wholes = [
        trace(f, {name: torch.rand(shape) for name, shape in SHAPES.items()})
        for f in (function, other)
    ]
    rests, ends = share_ends([*zip(wholes, kinds, strict=True)], ["u"], ["common.h"])
    assert set(ends) == {"a", "b"} and all(
        set(end.inputs) <= {"u", "k", "common.h"} for end in ends.values()
    )
    for whole, rest, sides in zip(wholes, rests, kinds, strict=True):
        handed = {
            f"{side}.{END}": evaluate(
                ends[kind],
                {
                    name: given[name if name in given else f"{side}.{name}"]
                    for name in ends[kind].inputs
                },
            )[END]
            for side, kind in sides.items()
        }
        found = evaluate(
            rest, {name: handed[name] if name in handed else given[name] for name in rest.inputs}
        )
        for name, expected in evaluate(whole, given).items():
            assert_close(found[name], expected, rtol=1e-14, atol=1e-14)
        assert not {"sin", "cos"} & {rest.graph.ops[x] for x in rest.live()}
        assert rest.operations() < whole.operations()


def test_what_depends_on_no_unknown_stays():
    whole = trace(
        lambda **x: x["i.k"].exp() * x["own"],
        {name: torch.rand(shape) for name, shape in SHAPES.items()},
    )
    (rest,), ends = share_ends([(whole, {"i": 0, "j": 0})], ["u"], ["common.h"])
    assert "exp" in {rest.graph.ops[x] for x in rest.live()} and not ends[0].outputs[END].nodes
    assert set(rest.inputs) == {"i.k", "own"}
