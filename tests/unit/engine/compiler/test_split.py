"""Splitting: what some inputs settle alone is computed before, and before with the rest gives the
whole.
"""

import pytest
import torch
from torch.testing import assert_close

from tests.cases.compiled_cases import cases
from tests.cases.evaluate import evaluate
from torchbeam.engine.compiler.split import HOISTED, split
from torchbeam.engine.compiler.trace import trace


def both(function, fixed, given):
    before, rest = split(function, fixed)
    handed = evaluate(before, {name: given[name] for name in before.inputs})
    return (
        before,
        rest,
        evaluate(
            rest, {**{name: given[name] for name in rest.inputs if name != HOISTED}, **handed}
        ),
    )


@pytest.mark.parametrize("name", cases())
def test_before_and_rest_are_the_whole(name):
    """Everything but the unknowns is fixed, as in Newton's loop; to a rounding of each division."""
    torch.manual_seed(0)
    function, inputs = cases()[name]
    traced, given = trace(function, inputs()), inputs(3)
    free = (
        ("u", "m")
        if "node" in name
        else ("r_i", "r_j", "q_i", "q_j", "qe_i", "qe_j", "stress", "half_i", "half_j")
    )
    before, rest, found = both(traced, set(given) - set(free), given)
    for field, expected in evaluate(traced, given).items():
        assert_close(found[field], expected, rtol=1e-13, atol=1e-13 * float(expected.abs().max()))
    assert (
        rest.operations() < traced.operations() and before.read() and set(free) <= set(rest.inputs)
    )
    assert before.outputs[HOISTED].shape == (rest.inputs[HOISTED])
    if "node" in name:
        assert rest.operations() < 0.9 * traced.operations()


def whole(fixed, free):
    """Nothing depends on the unknown."""
    return fixed.sin(), fixed * 2


def test_an_output_that_is_settled_comes_through():
    given = {"fixed": torch.randn(4, 2), "free": torch.randn(4)}
    function = trace(whole, {name: x[0] for name, x in given.items()})
    *_, found = both(function, ["fixed"], given)
    assert_close(found["0"], given["fixed"].sin(), rtol=0, atol=0)
    assert_close(found["1"], 2 * given["fixed"], rtol=0, atol=0)


@pytest.mark.parametrize(
    ("function", "handed"),
    [
        (lambda a, x: x * a.sin() + a.sin() * 2, 3),  # 2 sin a is a product away
        (lambda a, x: (x < a.exp()) * x + (x < -a.exp()) * 2 * x, 3),
        (
            lambda a, x: torch.outer(a[:2].sin(), a[1:].cos()).flatten().repeat(2)[:3] * x,
            3,
        ),  # three products of three numbers
        (lambda a, x: torch.outer(a.sin(), a.cos()) * x, 6),  # nine products of six numbers
        (lambda a, x: x * a, 0),  # inputs are read as they are
        (lambda a, x: torch.where(a.exp() < 2, x, -x), 3),  # truth values
    ],
)
def test_what_is_handed_over_is_small(function, handed):
    torch.manual_seed(1)
    given = {"a": torch.randn(5, 3), "x": torch.randn(5)}
    traced = trace(function, {name: x[0] for name, x in given.items()})
    before, _, found = both(traced, ["a"], given)
    assert before.outputs[HOISTED].shape == (handed,)
    assert_close(found["out"], evaluate(traced, given)["out"], rtol=1e-15, atol=1e-15)


def test_divisions_by_what_is_settled_are_products():
    function = trace(lambda h, x: x / h, {"h": torch.ones(1), "x": torch.ones(3)})
    before, rest = split(function, ["h"])
    ops = [rest.graph.ops[n] for n in rest.live()]
    assert "div" not in ops and before.outputs[HOISTED].shape == (1,)
