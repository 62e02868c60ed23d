"""Graph of scalars: equal nodes are one, constants and structural zeros are folded, and what tests
for NaN is kept.
"""

import math

import pytest

from torchbeam.engine.compiler.function import Function, Output
from torchbeam.engine.compiler.graph import Graph


@pytest.fixture
def g():
    return Graph()


@pytest.fixture
def xy(g):
    return g.input("x", 0), g.input("y", 0)


def test_equal_nodes_are_one(g, xy):
    x, y = xy
    assert g.make("add", x, y) == g.make("add", y, x)
    assert g.make("mul", x, g.const(3.0)) == g.make("mul", g.const(3), x)
    assert g.make("sub", x, y) != g.make("sub", y, x)
    assert g.const(0.0) == g.const(-0.0) == g.zero and g.const(math.nan) == g.const(math.nan)
    assert g.const(True) != g.one


def test_rules_of_arithmetic(g, xy):
    x, y = xy
    minus = g.make("neg", x)
    assert (
        g.make("add", x, g.zero)
        == g.make("sub", x, g.zero)
        == g.make("mul", g.one, x)
        == g.make("div", x, g.one)
        == x
    )
    assert g.make("mul", x, g.zero) == g.make("div", g.zero, x) == g.zero
    assert g.make("neg", minus) == g.make("mul", minus, g.const(-1.0)) == x
    assert g.make("add", y, minus) == g.make("sub", y, x) == g.make("neg", g.make("sub", x, y))
    assert g.make("mul", minus, g.make("neg", y)) == g.make("mul", x, y)
    assert g.make("div", x, g.const(4.0)) == g.make("mul", g.const(0.25), x)
    assert g.make("mul", g.const(2.0), g.make("mul", g.const(0.5), x)) == x
    assert g.make("abs", minus) == g.make("abs", x)
    assert g.make("max", x, x) == x and g.make("max", x, y, x) == g.make("max", y, x)


def test_what_tells_nan_is_left_alone(g, xy):
    x, _ = xy
    for op in ("sub", "div", "eq", "le"):
        assert g.ops[g.make(op, x, x)] == op
    assert g.make("lt", x, x) == g.const(False)


def test_rules_of_logic(g, xy):
    x, y = xy
    truth = g.make("lt", x, y)
    other = g.make("not", truth)
    assert (
        g.make("not", other)
        == g.make("and", truth, g.const(True))
        == g.make("or", g.const(False), truth)
        == truth
    )
    assert g.make("select", truth, x, x) == g.make("select", g.const(False), y, x) == x
    assert g.make("select", other, x, y) == g.make("select", truth, y, x)
    assert g.make("select", truth, g.make("select", truth, x, y), y) == g.make(
        "select", truth, x, y
    )
    both = g.make("add", g.make("select", truth, x, g.zero), g.make("select", truth, g.zero, y))
    assert both == g.make("select", truth, x, y)
    assert (
        g.truth(g.number(truth)) != truth and g.truths[g.truth(x)] and not g.truths[g.number(truth)]
    )


def test_a_pick_of_what_is_known_is_what_is_there(g, xy):
    x, y = xy
    assert g.make("pick", g.one, x, y, x) == y
    assert g.make("pick", y, x, x, x) == x and g.ops[g.make("pick", y, x, y)] == "pick"


@pytest.mark.parametrize(
    ("op", "args", "value"),
    [
        ("div", (1.0, 0.0), math.inf),
        ("sqrt", (4.0,), 2.0),
        ("log", (0.0,), -math.inf),
        ("max", (1.0, math.nan, 2.0), math.nan),
        ("atan2", (1.0, -1.0), 0.75 * math.pi),
        ("exponent", (10.0,), 3.0),
        ("mantissa", (10.0,), 1.25),
        ("power2", (-3.0,), 0.125),
        ("le", (1.0, 1.0), True),
    ],
)
def test_constants_are_computed_at_once(g, op, args, value):
    found = g.make(op, *(g.const(x) for x in args))
    assert g.ops[found] == "const" and (
        g.values[found] == value or value != value != g.values[found]
    )


def test_dead_nodes_are_not_counted(g, xy):
    x, y = xy
    g.make("sin", y)
    function = Function(g, {"x": (), "y": ()}, {"out": Output((), (g.make("mul", x, x),))})
    assert (
        function.operations() == 1
        and function.read() == {("x", 0)}
        and set(function.only(["out"]).inputs) == {"x"}
    )


def test_inputs_are_replaced_by_nodes_and_constants(g, xy):
    """x y + 1 of 2 z and y; and of x = 0: everything folds."""
    x, y = xy
    function = Function(
        g, {"x": (), "y": ()}, {"out": Output((), (g.make("add", g.make("mul", x, y), g.one),))}
    )
    other = Graph()
    twice = other.make("mul", other.const(2.0), other.input("z", 0))
    (found,) = function.into(other, {"x": [twice]})["out"]
    assert found == other.make("add", other.make("mul", twice, other.input("y", 0)), other.one)
    none = function.with_constants({"x": [0.0]})
    assert (
        none.operations() == 0
        and none.graph.values[none.outputs["out"].nodes[0]] == 1.0
        and list(none.inputs) == ["y"]
    )
