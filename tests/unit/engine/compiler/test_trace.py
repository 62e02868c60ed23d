"""Tracing: what a function of tensors does, as scalars; it evaluates to the same, and what has no
graph is refused by name.
"""

import math
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

from tests.cases.compiled_cases import cases
from tests.cases.evaluate import evaluate, fields
from torchbeam.engine.compiler.trace import NotTraceable, trace
from torchbeam.math import quaternions as quat
from torchbeam.scene.effects.load_point import jacobians

SPECIAL = torch.tensor([math.nan, math.inf, -math.inf, 0.0, -1.0, 1.0, -0.3, 0.3, 2.5, -2.5])
X, Y = torch.meshgrid(SPECIAL, SPECIAL, indexing="ij")
M, V, S = torch.randn(3, 3), torch.randn(3), 3 * torch.eye(6) + 0.3 * torch.randn(6, 6)

ELEMENTWISE = {
    "add": lambda x, y: torch.add(x, y, alpha=2),
    "sub": lambda x, y: x - y,
    "rsub": lambda x, y: 1.5 - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / (y + 4.25),
    "neg": lambda x, y: -x,
    "abs": lambda x, y: x.abs(),
    "sqrt": lambda x, y: x.sqrt(),
    "rsqrt": lambda x, y: x.rsqrt(),
    "square": lambda x, y: x.square(),
    "cube": lambda x, y: x**3,
    "inverse cube": lambda x, y: x**-3,
    "power 1.5": lambda x, y: x.abs() ** 1.5,
    "power -0.5": lambda x, y: x.abs() ** -0.5,
    "reciprocal": lambda x, y: (x + 7).reciprocal(),
    "sin": lambda x, y: x.sin(),
    "cos": lambda x, y: x.cos(),
    "tan": lambda x, y: x.tan(),
    "exp": lambda x, y: x.exp(),
    "log": lambda x, y: x.log(),
    "tanh": lambda x, y: x.tanh(),
    "atan2": lambda x, y: torch.atan2(x, y),
    "atan": lambda x, y: x.atan(),
    "asin": lambda x, y: x.asin(),
    "acos": lambda x, y: x.acos(),
    "hypot": lambda x, y: torch.hypot(x, 0.5 * x),
    "sigmoid": lambda x, y: x.sigmoid(),
    "floor": lambda x, y: x.floor(),
    "ceil": lambda x, y: x.ceil(),
    "round": lambda x, y: x.round(),
    "sign": lambda x, y: x.sign(),
    "maximum": lambda x, y: torch.maximum(x, y),
    "minimum": lambda x, y: torch.minimum(x, y),
    "clamp": lambda x, y: x.clamp(-0.5, 0.7),
    "clamp by tensors": lambda x, y: x.clamp(min=torch.tensor(-0.1)),
    "clamp_min": lambda x, y: x.clamp_min(0.2),
    "clamp_max": lambda x, y: x.clamp_max(0.2),
    "relu": lambda x, y: x.relu(),
    "where": lambda x, y: torch.where(x < y, x, 2.0),
    "lt": lambda x, y: x < y,
    "le": lambda x, y: x <= y,
    "gt": lambda x, y: x > y,
    "ge": lambda x, y: x >= y,
    "eq": lambda x, y: x == y,
    "ne": lambda x, y: x != y,
    "isnan": lambda x, y: x.isnan(),
    "isinf": lambda x, y: x.isinf(),
    "isfinite": lambda x, y: x.isfinite(),
    "xor": lambda x, y: torch.logical_xor(x > 0, y > 0),
    "logic": lambda x, y: ((x > 0) & ~(y > 0)) | torch.logical_and(x < 1, y < 1),
    "masked_fill": lambda x, y: x.masked_fill(y > 0, 3.0),
    "truth as number": lambda x, y: (x > 0).to(x) + (y > 0) * x.clamp(-3, 3) + y,
    "product of truths": lambda x, y: (x > 0) * (y > 0),
    "sum of truths": lambda x, y: (x > 0) + (y > 0),
    "lerp": lambda x, y: torch.lerp(x, y + 1, 0.25),
    "addcmul": lambda x, y: torch.addcmul(x, x, y, value=0.5),
    "addcdiv": lambda x, y: torch.addcdiv(x, x, y + 9, value=0.5),
    "in place": lambda x, y: (x * 2).add_(y).mul_(3).clamp_(max=4.0),
}


@pytest.mark.parametrize("name", ELEMENTWISE)
def test_elementwise_operations_are_torchs(name):
    """At NaN, inf, zeros and signs, and at random: to rounding."""
    for x, y in ((X.flatten(), Y.flatten()), (3 * torch.randn(50), 3 * torch.randn(50))):
        function = trace(ELEMENTWISE[name], {"x": x[:1], "y": y[:1]})
        found = evaluate(function, {"x": x[:, None], "y": y[:, None]})["out"][:, 0]
        assert_close(found, ELEMENTWISE[name](x, y), rtol=1e-14, atol=1e-15, equal_nan=True)


ARRAYS = {
    "reductions": lambda a, b: (
        a.sum(),
        a.sum(-1),
        b.mean(0, keepdim=True),
        a.amax(-1),
        a.amin((0, 1)),
        a.prod(0),
        a.max(),
        a.cumsum(1),
    ),
    "truths reduced": lambda a, b: ((a > 0).any(-1), (a < 1).all(), (a > 0).sum()),
    "products": lambda a, b: (
        a @ b,
        a @ V,
        V @ a,
        a.mT @ M,
        torch.einsum("ij,kj->ik", a, b),
        V @ a[0],
        torch.addmm(a, a, b),
    ),
    "batches of products": lambda a, b: (
        torch.stack((a, b)) @ a,
        torch.baddbmm(a[None], a[None], b[None]),
    ),
    "cross, norms": lambda a, b: (
        torch.linalg.cross(a, b),
        torch.linalg.cross(a, b, dim=0),
        torch.linalg.vector_norm(a, dim=-1),
        torch.linalg.vector_norm(b, ord=math.inf),
        torch.linalg.norm(a),
    ),
    "structure": lambda a, b: (
        torch.cat((a, b), -1),
        torch.stack((a, V.expand(3, 3)), 1),
        a[1:, [2, 0]],
        a.flip(0),
        a.roll(1, 0),
        a.repeat(2, 1),
        torch.diag_embed(a),
        torch.tril(b),
        torch.block_diag(a, b),
        a.flatten()[None],
        a.unbind(1)[1],
        a.diagonal(),
        a.T.reshape(-1),
        torch.nn.functional.pad(a, (1, 0, 0, 2), value=1.5),
    ),
    "from nothing": lambda a, b: (
        torch.zeros_like(a) + b,
        a.new_ones(2, 3),
        torch.eye(3) @ a,
        torch.full_like(a, 2.0) * b,
    ),
    "inverses": lambda a, b: (
        torch.linalg.inv(a + 4 * torch.eye(3)),
        torch.linalg.solve(b + 4 * torch.eye(3), a),
        torch.linalg.inv(a[:1, :1] + 3),
        torch.linalg.solve((a + 4 * torch.eye(3))[:2, :2], b[:2, 0]),
        torch.linalg.solve(S + torch.block_diag(a, b) / 9, torch.cat((a, b))),
    ),
    "a solve that is differentiated": lambda a, b: torch.func.jacrev(
        lambda x: torch.linalg.solve(x + 4 * torch.eye(3), b)
    )(a),
    "places of the largest": lambda a, b: torch.gather(
        a, 1, b.argmax(1, keepdim=True).expand(3, 2)
    ),
    "constant places": lambda a, b: (
        torch.gather(a, 1, torch.tensor([[0], [2], [1]])),
        a.index_select(0, torch.tensor([2, 2])),
    ),
    "places that come twice": lambda a, b: (
        a.index_put((torch.tensor([2, 0, 2]),), b, accumulate=True),
        torch.func.grad(lambda x: (x[:, [0, 0, 2]] ** 3 * b).sum())(a),
    ),
}


def written(a, b):
    """Writes into memory of constants and of values, through views."""
    out = torch.zeros(3, 4)
    out[:, :3] = a
    out[0].mul_(2)
    out[:, 3].copy_(b[:, 0])
    return out, a


def composed(a, b):
    """Operations that torch leaves whole in inference mode."""
    return torch.linalg.inv(a @ b.mT + 9 * torch.eye(3)).unflatten(
        0, (3, 1)
    ).flatten(), torch.linalg.multi_dot((a, b, a))


ARRAYS["writes through views"], ARRAYS["inference mode"] = written, composed


@pytest.mark.parametrize("name", ARRAYS)
def test_operations_on_arrays_are_torchs(name):
    torch.manual_seed(1)
    one, many = (
        dict(a=torch.randn(*lead, 3, 3), b=torch.randn(*lead, 3, 3)) for lead in ((), (4,))
    )
    with torch.inference_mode(name == "inference mode"):
        function = trace(ARRAYS[name], one)
    found = evaluate(function, many)
    for k in range(4):
        expected = ARRAYS[name](many["a"][k].clone(), many["b"][k].clone())
        expected = expected if isinstance(expected, tuple) else (expected,)
        assert len(expected) == len(found)
        for x, y in zip(found.values(), expected, strict=True):
            assert_close(x[k], y.to(x.dtype), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    "sizes", [(1e9, 2.0), (1e9, 2.0, 1.0), (1e9, 1e8, 1.0), (1e9, 1e5, 2.0, 1.0, 0.5)]
)
def test_small_matrices_are_solved_whatever_their_condition(sizes):
    """Of a condition of 1e9, with one soft direction or two: to 1e9 roundings; rows in any order,
    zeros on the diagonal too.
    """
    torch.manual_seed(4)
    n = len(sizes)
    Q = torch.linalg.qr(torch.randn(20, n, n))[0]
    A, x = Q @ torch.diag(torch.tensor(sizes)) @ Q.mT, torch.randn(20, n, 1)
    function = trace(torch.linalg.solve, {"A": A[0], "B": x[0]})
    inverse = trace(torch.linalg.inv, {"A": A[0]})
    for matrix, tolerance in (
        (A, 1e9 * 1e-15),
        (A.flip(-2), 1e9 * 1e-15),
        (torch.eye(n).roll(1, 0).expand(20, n, n), 0),
    ):
        found = evaluate(function, {"A": matrix, "B": matrix @ x})["out"]
        assert_close(found, x, rtol=0, atol=tolerance * float(x.abs().max()))
        found = evaluate(inverse, {"A": matrix})["out"] @ matrix @ x
        assert_close(found, x, rtol=0, atol=n * tolerance * float(x.abs().max()))


ROTATIONS = {
    "skew": (quat.skew, "v"),
    "multiply": (quat.multiply, "qp"),
    "matrix": (quat.matrix, "q"),
    "rotate": (quat.rotate, "qv"),
    "exponential": (quat.exponential, "v"),
    "logarithm": (quat.logarithm, "q"),
    "half_way": (quat.half_way, "qp"),
    "spin_of_vector": (quat.spin_of_vector, "vw"),
    "from_matrix": (lambda q: quat.from_matrix(quat.matrix(q)), "q"),
}


@pytest.mark.parametrize("name", ROTATIONS)
def test_rotations_are_traced_as_they_stand(name):
    torch.manual_seed(2)
    function, letters = ROTATIONS[name]
    values = {
        **{n: torch.randn(5, 3) for n in "vw"},
        **{n: quat.normalize(torch.randn(5, 4)) for n in "qp"},
    }
    values["v"][0] = values["w"][0] = 0  # where series stand
    given = {n: values[n] for n in letters}
    found = evaluate(
        trace(lambda **x: function(*x.values()), {n: x[0] for n, x in given.items()}), given
    )
    assert_close(found["out"], function(*given.values()), rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("name", cases())
def test_local_functions_are_traced_as_they_stand(name):
    """Element and node of the midpoint step, of another batch than the one that was traced: to
    rounding of sums of some ten terms.
    """
    torch.manual_seed(3)
    function, inputs = cases()[name]
    traced, given = trace(function, inputs()), inputs(4)
    found = evaluate(traced, given)
    expected = fields(function(**given))
    assert list(found) == list(expected)
    for field, x in found.items():
        assert_close(
            x,
            expected[field].expand_as(x),
            rtol=1e-13,
            atol=1e-13 * float(expected[field].abs().max()),
        )


def test_values_of_the_example_do_not_matter():
    """A graph of a function with branches, traced at a NaN, is the same as traced anywhere."""
    v = torch.randn(3)
    nan = trace(quat.exponential, {"phi": v * math.nan})
    assert nan.graph.ops == trace(quat.exponential, {"phi": v}).graph.ops


def test_hooks_on_saved_tensors_change_no_graph():
    """Derivatives within the function, which torch has not by reverse mode beside such hooks, are
    traced as ever.
    """
    x, length = torch.tensor([1.0, 2.0, 3.0]), torch.tensor([0.5])

    def function(x):
        return jacobians(lambda y: y * (y.norm(dim=-1, keepdim=True) - length), x)[0]

    with torch.autograd.graph.save_on_cpu():
        found = trace(function, {"x": x})
    assert found.graph.ops == trace(function, {"x": x}).graph.ops
    assert_close(evaluate(found, {"x": x})["out"], function(x), rtol=1e-14, atol=1e-14)


def test_a_number_of_numbers_is_evaluated_without_leading_axes():
    assert evaluate(trace(lambda x: x.sum(), {"x": V}), {"x": V})["out"] == V.sum()


def test_single_precision_is_traced_and_evaluated_in_single_precision():
    function = trace(quat.exponential, {"phi": torch.zeros(3, dtype=torch.float32)})
    found = evaluate(function, {"phi": torch.ones(3, dtype=torch.float32)})["out"]
    assert found.dtype == torch.float32 and torch.get_default_dtype() == torch.float64
    assert_close(found, quat.exponential(torch.ones(3, dtype=torch.float32)), rtol=1e-6, atol=1e-7)


def test_constants_are_read_where_they_are_used():
    scale = torch.tensor([2.0, 3.0])
    function = trace(lambda x: x * scale, {"x": torch.zeros(2)})
    scale[:] = 0
    assert evaluate(function, {"x": torch.ones(2)})["out"].tolist() == [2.0, 3.0]


def branching(x):
    return x if x.sum() > 0 else -x


PARAMETER = torch.tensor([1.0, 2.0, 3.0], requires_grad=True)
UNPLACED = ("a number", "factors that are read")  # known where the function is done
REFUSED = {
    "a parameter": (lambda x: x * PARAMETER, "carries gradient"),
    "what a parameter gives": (lambda x: x * (2 * PARAMETER)[1], "carries gradient"),
    "bits": (lambda x: x.view(torch.int64) + 1, "by their bits"),
    "a part of bits": (lambda x: x.view(torch.int32), "by their bits"),
    "factors that are read": (
        lambda x: 2 * torch.ops.aten._linalg_solve_ex(torch.diag(x), x)[1],
        "the factors of a matrix",
    ),
    "control flow": (branching, "control flow by values"),
    "item": (lambda x: x * x[0].item(), "local_scalar_dense"),
    "tolist": (lambda x: torch.tensor(x.tolist()), "tolist"),
    "numpy": (lambda x: torch.tensor(x.numpy()), "numpy"),
    "eigenvalues": (lambda x: torch.linalg.eigh(torch.outer(x, x))[0], "aten._linalg_eigh"),
    "sort": (lambda x: x.sort()[0], "aten.sort"),
    "a traced mask": (lambda x: x[x > 0], "aten.index"),
    "factors": (lambda x: torch.linalg.lu_factor(torch.outer(x, x))[0], "aten.linalg_lu_factor"),
    "what is detached": (lambda x: x.detach().zero_() + x, "did not make"),
    "a number": (lambda x: 3.0, "float was returned"),
    "an unknown function": (lambda x: torch.special.bessel_j0(x), "bessel_j0"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_has_no_graph_is_refused_by_name(name):
    """The sentence names the operation and the line that called it."""
    function, words = REFUSED[name]
    with pytest.raises(NotTraceable, match=words) as caught:
        trace(function, {"x": torch.tensor([1.0, 2.0, 3.0])})
    if name not in UNPLACED:
        line = function.__code__.co_firstlineno + (name == "control flow")
        assert f"{Path(__file__).name}:{line}" in str(caught.value)


def test_the_shape_of_a_parameter_may_be_read():
    function = trace(
        lambda x: x + torch.ones_like(PARAMETER) + PARAMETER.new_zeros(3), {"x": torch.zeros(3)}
    )
    assert evaluate(function, {"x": torch.zeros(3)})["out"].tolist() == [1.0, 1.0, 1.0]
