"""Derivatives on the graph against torch.autograd: of each operation, of special points, of
torchbeam's local functions.
"""

import pytest
import torch
from torch.testing import assert_close

from tests.cases.compiled_cases import cases
from tests.cases.evaluate import evaluate, fields
from torchbeam.engine.compiler.derivative import bar, dot, jvp, vjp
from torchbeam.engine.compiler.trace import trace


def gradients(function, given, bars):
    """Of the sum of outputs times cotangents, by autograd; zero where nothing depends on an
    input.
    """
    given = {name: x.detach().clone().requires_grad_() for name, x in given.items()}
    found = fields(function(**given))
    total = sum((x * bars[name]).sum() for name, x in found.items())
    got = torch.autograd.grad(total, list(given.values()), allow_unused=True)
    return {
        name: torch.zeros_like(x) if g is None else g
        for (name, x), g in zip(given.items(), got, strict=True)
    }


SCALARS = {
    "add": lambda x, y: x + 2 * y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y * x,
    "div": lambda x, y: x / y,
    "neg": lambda x, y: -x * y,
    "sqrt": lambda x, y: (x * x + y * y).sqrt(),
    "sin": lambda x, y: torch.sin(x * y),
    "cos": lambda x, y: torch.cos(x * y),
    "exp": lambda x, y: torch.exp(x * y),
    "log": lambda x, y: torch.log(x * x + 1),
    "atan2": lambda x, y: torch.atan2(x, y),
    "tanh": lambda x, y: torch.tanh(x * y),
    "abs": lambda x, y: x.abs() * y,
    "max": lambda x, y: torch.maximum(x, y) * x,
    "min": lambda x, y: torch.minimum(x, y) * x,
    "select": lambda x, y: torch.where(x < y, x * x, y * x),
    "clamp": lambda x, y: x.clamp(-0.5, 0.5) * y,
    "floor": lambda x, y: x.floor() * y,
    "pow": lambda x, y: x**3 / y**2,
    "pick": lambda x, y: torch.gather(
        torch.stack((x, y, x * y, y * y), -1), -1, (x.abs() * 2).long().clamp(0, 3)[..., None]
    )[..., 0],
}


@pytest.mark.parametrize("name", SCALARS)
def test_each_operation_has_torchs_derivative(name):
    torch.manual_seed(0)
    given = {"x": torch.randn(50), "y": torch.randn(50)}
    function = trace(SCALARS[name], {"x": torch.tensor(1.0), "y": torch.tensor(2.0)})
    bars = {"out": torch.randn(50)}
    found = evaluate(vjp(function, ["x", "y"]), {**given, bar("out"): bars["out"]})
    for field, expected in gradients(SCALARS[name], given, bars).items():
        assert_close(found[bar(field)], expected, rtol=1e-12, atol=1e-13)


SPECIAL = {
    "norm at 0": (lambda x: torch.linalg.vector_norm(x), torch.zeros(3)),
    "abs at 0": (lambda x: x.abs(), torch.zeros(3)),
    "atan2 at 0": (lambda x: torch.atan2(x[0], x[1]), torch.zeros(2)),
    "the largest of equals": (lambda x: x.amax(), torch.tensor([1.0, 2.0, 2.0, 2.0])),
    "maximum of equals": (lambda x: torch.maximum(x, torch.ones(2)), torch.ones(2)),
    "the smallest of equals": (lambda x: x.amin(), torch.tensor([1.0, 1.0, 2.0])),
    "clamp at its bound": (lambda x: x.clamp(0.0, 1.0), torch.tensor([0.0, 1.0])),
    "a branch that is not taken": (
        lambda x: torch.where(x > 0, x, -x.sqrt()),
        torch.tensor([1.0, -2.0]),
    ),
    "a branch that is not taken, unguarded": (
        lambda x: torch.where(x > 0, x, x * torch.nan),
        torch.ones(2),
    ),
}


@pytest.mark.parametrize("name", SPECIAL)
def test_derivatives_at_special_points_are_torchs(name):
    function, x = SPECIAL[name]
    bars = {"out": torch.full(function(x).shape, 1.5)}
    found = evaluate(vjp(trace(function, {"x": x}), ["x"]), {"x": x, bar("out"): bars["out"]})[
        bar("x")
    ]
    expected = gradients(function, {"x": x}, bars)["x"]
    assert_close(found, expected, rtol=1e-14, atol=0, equal_nan=True)


@pytest.mark.parametrize("name", cases())
def test_products_with_the_jacobian_of_local_functions(name):
    """vjp against autograd; jvp by <bar, J dot> = <J^T bar, dot>: to rounding of sums of some
    hundred terms.
    """
    torch.manual_seed(1)
    function, inputs = cases()[name]
    traced, given = trace(function, inputs()), inputs(3)
    bars = {field: torch.randn(3, *out.shape) for field, out in traced.outputs.items()}
    found = evaluate(vjp(traced, given), {**given, **{bar(field): x for field, x in bars.items()}})
    expected = gradients(function, given, bars)
    size = max(float(x.abs().max()) for x in expected.values())
    for field in given:
        assert_close(found[bar(field)], expected[field], rtol=1e-12, atol=1e-12 * size)
    dots = {field: torch.randn_like(x) for field, x in given.items()}
    forward = evaluate(
        jvp(traced, given), {**given, **{dot(field): x for field, x in dots.items()}}
    )
    left = sum((forward[dot(field)] * x).sum() for field, x in bars.items())
    right = sum((found[bar(field)] * x).sum() for field, x in dots.items())
    assert_close(left, right, rtol=1e-12, atol=1e-12 * size)


def test_only_what_is_asked_for_is_differentiated():
    """What the gradient does not need is dead; an input that nothing depends on has a zero."""
    function = trace(
        lambda x, y, z: (x * y, torch.sin(z)), {name: torch.tensor(1.0) for name in "xyz"}
    )
    found = vjp(function, ["x", "z"], ["0"])
    assert set(found.outputs) == {"x_bar", "z_bar"} and found.operations() == 1
    assert found.read() == {("y", 0), ("0_bar", 0)}
