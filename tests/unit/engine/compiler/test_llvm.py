"""Native code against torch: each operation and elementary function, local functions by lanes, and
lanes apart.
"""

import math

import mpmath
import numpy as np
import pytest
import torch
from torch.testing import assert_close

from tests.cases.compiled_cases import cases, native
from tests.cases.evaluate import evaluate
from torchbeam.engine.compiler.derivative import bar, vjp
from torchbeam.engine.compiler.elementary import elementary
from torchbeam.engine.compiler.function import Function, Output
from torchbeam.engine.compiler.graph import Graph
from torchbeam.engine.compiler.llvm import Module
from torchbeam.engine.compiler.trace import trace

pytest.importorskip("llvmlite")

SPECIAL = torch.tensor([math.nan, math.inf, -math.inf, 0.0, -1.0, 1.0, -0.3, 0.5])
X, Y = (x.flatten() for x in torch.meshgrid(SPECIAL, SPECIAL, indexing="ij"))
ONE = (
    "neg",
    "sqrt",
    "norm",
    "abs",
    "floor",
    "round",
    "sin",
    "cos",
    "exp",
    "log",
    "tanh",
    "expm1",
    "log1p",
    "sinh",
    "cosh",
    "asinh",
    "acosh",
    "atanh",
    "erf",
    "erfc",
)
TWO = ("add", "sub", "mul", "div", "max", "min", "atan2")


def operations():
    """Each operation of a graph on x and y."""
    graph = Graph()
    x, y = graph.input("x", 0), graph.input("y", 0)
    lt, le, eq = (graph.make(op, x, y) for op in ("lt", "le", "eq"))
    # fmt: off
    nodes = {
        **{op: graph.make(op, x) for op in ONE}, **{op: graph.make(op, x, y) for op in TWO},
        "lt": lt, "le": le, "eq": eq,
        "and": graph.make("and", lt, graph.make("lt", x, graph.zero)),
        "or": graph.make("or", eq, lt),
        "not": graph.make("not", lt), "truth": graph.truth(x),
        "finite": graph.make("eq", graph.make("sub", x, x), graph.zero),
        "select": graph.make("select", le, x, y),
        "select of truths": graph.make("select", lt, eq, le),
        "largest": graph.make("max", x, graph.const(0.2), y),
        "smallest": graph.make("min", x, graph.const(0.2), y)}
    # fmt: on
    return Function(
        graph, {"x": (), "y": ()}, {name: Output((), (node,)) for name, node in nodes.items()}
    )


@pytest.mark.parametrize("lanes", [1, 8])
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_operations_are_torchs_at_special_values(lanes, dtype):
    """NaN, inf, zero, signs: as torch has them, finite values to two units in the last place."""
    function, loaded = operations(), {}
    x, y = X.to(dtype), Y.to(dtype)
    expected = evaluate(function, {"x": x, "y": y})
    parts = [slice(k, k + lanes) for k in range(0, len(x), lanes)]
    found = [native(function, {"x": x[some], "y": y[some]}, dtype, loaded=loaded) for some in parts]
    for name, value in expected.items():
        assert_close(
            torch.cat([part[name] for part in found]),
            value.to(dtype),
            rtol=2 * torch.finfo(dtype).eps,
            atol=0,
            equal_nan=True,
            msg=lambda text, name=name: f"{name}: {text}",
        )


# Arguments of every size, also next to multiples of pi/2; and the largest error, in units in the
# last place.
DRAW = np.random.default_rng(0)
SIZES = 10.0 ** DRAW.integers(-5, 6, 1000)
ANGLES = np.concatenate(
    [DRAW.uniform(-size, size, 300) for size in (1e6, 3.0, 1e-3)]
    + [DRAW.integers(-600000, 600000, 100) * (np.pi / 2)]
)
# fmt: off
ARGUMENTS = {
    "sin": ((ANGLES,), 1), "cos": ((ANGLES,), 1),
    "atan2": ((DRAW.normal(size=1000) * SIZES, DRAW.normal(size=1000) * SIZES[::-1].copy()), 2),
    "tanh": ((np.concatenate([DRAW.uniform(-size, size, 320) for size in (30.0, 1.0, 1e-3)]),), 2),
    "exp": ((np.concatenate([DRAW.uniform(-size, size, 500) for size in (700.0, 1.0)]),), 1),
    "log": ((np.concatenate((np.exp(DRAW.uniform(-740, 709, 500)),
                             1 + DRAW.uniform(-0.3, 0.42, 500))),), 1),
    "expm1": ((DRAW.normal(size=1000) * SIZES.clip(1e-5, 100),), 4),
    "log1p": ((np.concatenate((DRAW.uniform(-1, 1, 400) * SIZES[:400].clip(1e-5, 1), SIZES[400:])),
               ), 4),
    "sinh": ((DRAW.uniform(-1, 1, 1000) * SIZES.clip(1e-5, 100),), 4),
    "cosh": ((DRAW.normal(size=1000) * SIZES.clip(1e-5, 100),), 4),
    "asinh": ((DRAW.normal(size=1000) * SIZES,), 4),
    "acosh": ((1 + DRAW.uniform(0, 1, 1000) * SIZES,), 4),
    "atanh": ((DRAW.uniform(-1, 1, 1000) * SIZES.clip(1e-5, 1),), 4),
    "erf": ((DRAW.normal(size=1000) * SIZES.clip(1e-5, 5),), 2),
    "erfc": ((DRAW.uniform(-1, 1, 1000) * SIZES.clip(1e-5, 25),), 8)}
# fmt: on


@pytest.mark.parametrize("name", ARGUMENTS)
def test_elementary_functions_are_exact_to_a_unit_or_two(name):
    """With fused products, as compiled, and without, in torch; against 200 bits."""
    args, units = ARGUMENTS[name]
    given = {
        field: torch.from_numpy(x)
        for field, x in zip("yx" if len(args) == 2 else "x", args, strict=True)
    }
    graph = Graph()
    node = graph.make(name, *(graph.input(field, 0) for field in given))
    compiled = native_rows(
        Function(graph, dict.fromkeys(given, ()), {"out": Output((), (node,))}), given
    )
    in_torch = evaluate(elementary(name), given)["out"]
    with mpmath.workprec(200):
        for k, numbers in enumerate(zip(*args, strict=True)):
            exact = getattr(mpmath, name)(*(mpmath.mpf(float(x)) for x in numbers))
            unit = math.ulp(float(exact))
            for found in (compiled, in_torch):
                assert abs(mpmath.mpf(float(found[k])) - exact) <= units * unit, numbers


def native_rows(function, given):
    """A compiled function of many samples, eight at a time."""
    library = {}
    rows = [
        native(function, {name: x[k : k + 8] for name, x in given.items()}, loaded=library)["out"]
        for k in range(0, len(next(iter(given.values()))), 8)
    ]
    return torch.cat(rows)


@pytest.mark.parametrize(
    ("name", "x", "expected"),
    [
        (
            "exp",
            [710.0, -746.0, -740.0, math.inf, -math.inf, 0.0],
            [math.inf, 0.0, math.exp(-740.0), math.inf, 0.0, 1.0],
        ),
        ("tanh", [800.0, -800.0, -math.inf, 0.0], [1.0, -1.0, -1.0, 0.0]),
        ("expm1", [710.0, -800.0, math.inf, -math.inf, 0.0], [math.inf, -1.0, math.inf, -1.0, 0.0]),
        ("log1p", [-1.0, math.inf, 0.0, 5e-324], [-math.inf, math.inf, 0.0, 5e-324]),
        ("erf", [40.0, -math.inf, math.inf, 0.0], [1.0, -1.0, 1.0, 0.0]),
        ("erfc", [40.0, -math.inf, math.inf], [0.0, 2.0, 0.0]),
        ("sinh", [-math.inf, math.inf, 0.0], [-math.inf, math.inf, 0.0]),
        ("cosh", [-math.inf, math.inf], [math.inf, math.inf]),
        ("asinh", [-math.inf, math.inf, 0.0], [-math.inf, math.inf, 0.0]),
        ("acosh", [1.0, math.inf], [0.0, math.inf]),
        ("atanh", [-1.0, 1.0, 0.0], [-math.inf, math.inf, 0.0]),
        ("log", [0.0, 5e-324, math.inf, 1.0], [-math.inf, math.log(5e-324), math.inf, 0.0]),
    ],
)
def test_elementary_functions_at_the_ends_of_their_range(name, x, expected):
    found = evaluate(elementary(name), {"x": torch.tensor(x)})["out"]
    assert_close(found, torch.tensor(expected), rtol=1e-15, atol=0)


def test_powers_are_exact_to_what_their_exponent_tells():
    """x^y = exp(y log x): to 2 + |y log x| units; signs, zeros and whole exponents as torch has
    them.
    """
    x = torch.from_numpy(np.exp(DRAW.normal(size=500) * 3))
    y = torch.from_numpy(DRAW.normal(size=500) * 4)
    found = evaluate(elementary("pow"), {"x": x, "y": y})["out"]
    assert (found / x**y - 1).abs().sub((3 + (y * x.log()).abs()) * 2.3e-16).max() < 0
    x, y = (
        v.flatten()
        for v in torch.meshgrid(
            torch.tensor([0.0, -2.0, -0.5, 1.0, 3.0]),
            torch.tensor([0.0, 1.0, 2.0, 3.0, -1.0, -2.0, 0.5, 1.5]),
            indexing="ij",
        )
    )
    assert_close(
        evaluate(elementary("pow"), {"x": x, "y": y})["out"],
        x**y,
        rtol=1e-14,
        atol=0,
        equal_nan=True,
    )


@pytest.mark.parametrize("lanes", [1, 4, 8])
@pytest.mark.parametrize("name", cases())
def test_local_functions(name, lanes):
    """Compiled = torch, to some units in the last place of the largest number: fused products, sums
    of some ten terms.
    """
    torch.manual_seed(0)
    function, inputs = cases()[name]
    traced, given = trace(function, inputs()), inputs(lanes)
    for field, expected in evaluate(traced, given).items():
        found = native_of(name, lanes, torch.float64, traced, given)[field]
        assert_close(found, expected, rtol=0, atol=1e-14 * float(expected.abs().max()))


LIBRARIES = {}


def native_of(name, lanes, dtype, traced, given):
    """Compiled once for all fields and tests."""
    return native(traced, given, dtype, loaded=LIBRARIES.setdefault((name, lanes, dtype), {}))


@pytest.mark.parametrize("name", cases())
def test_local_functions_in_single_precision(name):
    """Of 16 lanes, against the same in float64: a few units of float32, more where a strain is a
    difference.
    """
    torch.manual_seed(0)
    function, inputs = cases()[name]
    traced, given = trace(function, inputs()), inputs(16)
    given = {field: x.float().double() for field, x in given.items()}
    found = native_of(name, 16, torch.float32, traced, given)
    for field, expected in evaluate(traced, given).items():
        assert_close(
            found[field].double(), expected, rtol=0, atol=3e-5 * float(expected.abs().max())
        )


@pytest.mark.parametrize("name", ["element in a plane", "node in a space"])
def test_lanes_do_not_mix(name):
    """One lane of NaN leaves the others as they are, to the bit."""
    torch.manual_seed(0)
    function, inputs = cases()[name]
    traced, given = trace(function, inputs()), inputs(8)
    clean = native_of(name, 8, torch.float64, traced, given)
    for x in given.values():
        x[3] = math.nan
    spoilt = native_of(name, 8, torch.float64, traced, given)
    others = [0, 1, 2, 4, 5, 6, 7]
    for field, x in clean.items():
        assert torch.equal(spoilt[field][others], x[others])
    assert any(x[3].isnan().any() for x in spoilt.values())


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("lanes", [1, 8])
def test_numbers_of_a_table_are_loaded_from_where_they_lie(lanes, dtype):
    """Each lane its own, without a comparison, and computed numbers by comparisons: to the bit as
    torch has them. Beyond the table, and at NaN, which torch refuses: numbers of the table.
    """
    torch.manual_seed(0)

    def column(rows, k):
        return torch.gather(rows, 0, k.long()[None, None].expand(1, 3))[0]

    given = {"rows": torch.randn(lanes, 5, 3).to(dtype), "k": (torch.arange(lanes) % 5).to(dtype)}
    form = {"rows": torch.randn(5, 3), "k": torch.tensor(2.0)}
    table = trace(column, form)
    computed = trace(lambda rows, k: column(rows.abs(), k), form)
    for function in (table, computed):
        found, expected = native(function, given, dtype), evaluate(function, given)
        assert torch.equal(found["out"], expected["out"])
    text = {}
    for name, function in {"table": table, "computed": computed}.items():
        module = Module(lanes, dtype)
        module.define("column", function)
        text[name] = module.text()
    assert "fcmp oeq" not in text["table"] and "fcmp oeq" in text["computed"]
    for beyond, row in {math.nan: 0, -7.0: 0, math.inf: 4, 9.0: 4}.items():
        found = native(table, given | {"k": torch.full_like(given["k"], beyond)}, dtype)
        assert torch.equal(found["out"], given["rows"][:, row])


def test_gradients_are_compiled_too():
    torch.manual_seed(0)
    function, inputs = cases()["element in a plane"]
    traced = trace(function, inputs())
    backward, given = vjp(traced, traced.inputs), inputs(4)
    given |= {bar(name): torch.randn(4, *out.shape) for name, out in traced.outputs.items()}
    found = native(backward, given)
    for field, expected in evaluate(backward, given).items():
        assert_close(
            found[field], expected, rtol=0, atol=1e-14 * max(float(expected.abs().max()), 1e-300)
        )


def test_what_cannot_be_emitted_is_refused():
    module = Module(4)
    module.define("twice", operations())
    with pytest.raises(ValueError, match="a second function 'twice'"):
        module.define("twice", operations())
    with pytest.raises(ValueError, match=r"torch.float16 was given"):
        Module(4, torch.float16)


def test_a_function_that_gives_nothing_is_defined():
    """As what comes before the iterations, where all depends on the unknowns."""
    nothing = trace(lambda x: {"y": 2 * x}, {"x": torch.ones(())}).only([])
    module = Module(2, torch.float64)
    module.define("nothing", nothing)
    assert '@"nothing"' in module.text()
