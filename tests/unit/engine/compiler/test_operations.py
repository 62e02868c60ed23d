"""Operations of torch that users write: traced, their values and derivatives are torch's, at kinks
too; or refused in words.
"""

import math

import pytest
import torch
from torch.nn import functional as F
from torch.testing import assert_close

from tests.cases.evaluate import evaluate
from torchbeam.engine.compiler.derivative import bar, vjp
from torchbeam.engine.compiler.trace import NotTraceable, trace

EDGES = torch.tensor([-1.0, -0.4, 0.1, 0.5, 1.2])
HEIGHTS = torch.tensor([0.3, -0.7, 0.2, 0.9, -0.1])
SINES, GRID = torch.sin(torch.arange(9.0)), torch.arange(12.0).reshape(3, 4).sin()
DRAWN = torch.Generator().manual_seed(0)
A, B = torch.randn(4, 7, generator=DRAWN), torch.randn(4, 4, generator=DRAWN)
WIDE = torch.randn(2, 7, 7, generator=DRAWN)


def interpolated(x):
    k = (torch.searchsorted(EDGES, x.contiguous()) - 1).clamp(0, 3)
    return HEIGHTS[k] + (x - EDGES[k]) * (HEIGHTS[k + 1] - HEIGHTS[k]) / (EDGES[k + 1] - EDGES[k])


def by_buckets(x):
    k = (torch.bucketize(x, EDGES, right=True) - 1).clamp(0, 3)
    return torch.lerp(HEIGHTS[k], HEIGHTS[k + 1], (x - EDGES[k]) / (EDGES[k + 1] - EDGES[k]))


def by_places(x):
    place = ((x + 2) * 2).clamp(0, 7.999)
    k = place.long()
    return SINES[k] * (1 - (place - k)) + SINES[k + 1] * (place - k)


def of_two(x):
    i, j = (x.abs() * 2).int().clamp(0, 2), (x.abs() * 3).long().clamp(0, 3)
    return GRID[i, j] * x + GRID[:, j].sum(0)


ONE = {
    name: getattr(torch, name)
    for name in (
        "tanh sigmoid relu erf erfc expm1 log1p sinh cosh asinh tan atan exp2 trunc frac sgn sinc "
        "square sign deg2rad abs exp sin cos nan_to_num positive neg floor ceil round"
    ).split()
}
ONE |= {
    f"F.{name}": getattr(F, name)
    for name in (
        "relu relu6 elu selu celu gelu silu mish softplus leaky_relu hardtanh hardswish "
        "logsigmoid softsign tanhshrink softshrink hardshrink sigmoid tanh"
    ).split()
}
# fmt: off
ONE |= {
    "acosh": lambda x: torch.acosh(1.01 + x.abs()), "atanh": lambda x: torch.atanh(x / 8),
    "asin": lambda x: torch.asin(x / 8),
    "acos": lambda x: torch.acos(x / 8), "log2": lambda x: torch.log2(x.abs() + 1),
    "log10": lambda x: torch.log10(x.abs() + 1),
    "power": lambda x: (x.abs() + 0.1)**1.7, "power of both": lambda x: (x.abs() + 0.1)**x,
    "power of 2": lambda x: 2.0**x,
    "odd power": lambda x: (x - 0.05)**3,
    "float_power": lambda x: torch.float_power(x.abs() + 0.1, 1.3),
    "fmod": lambda x: torch.fmod(x, 0.7), "remainder": lambda x: torch.remainder(x, 0.7),
    "whole quotient": lambda x: x.detach() // 0.7 * x,
    "detached": lambda x: x.detach() * x.sin() + (x * x).data[:1] * x,
    "quotient to zero": lambda x: torch.div(x, 0.7, rounding_mode="trunc") * x,
    "heaviside": lambda x: torch.heaviside(x.detach(), torch.tensor(0.5)) * x,
    "fmax": lambda x: torch.fmax(x, torch.tensor(0.2)),
    "fmin": lambda x: torch.fmin(x, x.sin() + 0.01), "logaddexp": lambda x: torch.logaddexp(x, -x),
    "logaddexp2": lambda x: torch.logaddexp2(x, -x),
    "copysign": lambda x: torch.copysign(x + 0.01, torch.tensor(-2.0)),
    "xlogy": lambda x: torch.xlogy(x.abs(), x.abs() + 0.2),
    "logit": lambda x: torch.logit(x.sigmoid()),
    "hypot": lambda x: torch.hypot(x, x + 1.3), "ldexp": lambda x: torch.ldexp(x, torch.tensor(3)),
    "ndtr": torch.special.ndtr, "expit": torch.special.expit,
    "entr": lambda x: torch.special.entr(x.abs() + 0.1),
    "clamp": lambda x: x.clamp(-0.5, 0.7),
    "clamp by tensors": lambda x: torch.clamp(x, torch.tensor(-0.5), torch.tensor(0.7)),
    "clip": lambda x: x.clip(max=0.3),
    "clamp by what moves": lambda x: torch.clamp(x.sin(), -x - 9, x + 9),
    "round to a tenth": lambda x: x.round(decimals=1) * x, "interpolated": interpolated,
    "by buckets": by_buckets,
    "by places": by_places, "of a table of two": of_two,
    "where": lambda x: torch.where(x > 0, x, -2 * x),
    "triangle": lambda x: torch.abs(x - 2 * torch.floor((x + 1) / 2)),
    "maximum": lambda x: torch.maximum(x, x.cos()),
    "isclose": lambda x: torch.isclose(x, x + 1e-3).to(x) * x,
    "lerp": lambda x: torch.lerp(x, x**2, 0.3),
    "rsqrt": lambda x: (x**2 + 1).rsqrt(), "atan2": lambda x: torch.atan2(x, x + 2.2),
    "gelu by tanh": lambda x: F.gelu(x, approximate="tanh"),
    "steep softplus": lambda x: F.softplus(x, beta=20.0, threshold=10.0),
    "threshold": lambda x: F.threshold(x, 0.1, -2.0),
    "prelu": lambda x: F.prelu(x[None], torch.tensor([0.25]))[0],
    "relu in place": lambda x: F.relu(x * 1, inplace=True),
    "tanh in place": lambda x: (x * 1).tanh_(),
    "elu in place": lambda x: F.elu(x * 1, inplace=True),
    "silu in place": lambda x: F.silu(x * 1, inplace=True),
    "dropout of eval": lambda x: F.dropout(x, 0.5, False),
}
# fmt: on
SPECIAL = torch.tensor(
    [0.0, 1.0, -1.0, 0.5, -0.5, 0.7, -0.7, 0.1, 3.0, -3.0, 6.0, 1.2, -0.4, 7.4, -5.9]
)


@pytest.mark.parametrize("name", ONE)
def test_functions_of_one_number_are_torchs(name):
    """Value, derivative of the graph, and traced derivative by torch, at kinks and at random; to
    1e-12.
    """
    function, x = ONE[name], torch.cat((SPECIAL, 2 * torch.randn(10, generator=DRAWN)))
    check(lambda x: function(x), x[:, None])


# fmt: off
VECTOR = {
    "norm": torch.linalg.norm, "norm of order 3": lambda x: torch.linalg.vector_norm(x, 3),
    "norm of order 1": lambda x: x.norm(1),
    "largest": lambda x: x.norm(math.inf),
    "norm by rows": lambda x: x.reshape(1, 7).norm(dim=-1, keepdim=True),
    "Frobenius": lambda x: torch.linalg.matrix_norm(torch.outer(x, x)),
    "normalize": lambda x: F.normalize(x, dim=-1),
    "softmax": lambda x: x.softmax(-1), "log_softmax": lambda x: F.log_softmax(x, -1),
    "logsumexp": lambda x: x.logsumexp(-1),
    "std": lambda x: x.std(), "var": lambda x: x.var(unbiased=False),
    "layer_norm": lambda x: F.layer_norm(x, (7,)),
    "group_norm": lambda x: F.group_norm(x[None, :6], 2)[0],
    "rms_norm": lambda x: F.rms_norm(x, (7,)),
    "batch_norm of eval": lambda x: F.batch_norm(x[None], HEIGHTS[:1].expand(7),
                                                 torch.full((7,), 2.0), torch.arange(7.0)),
    "cosine": lambda x: F.cosine_similarity(x, x.sin() + 1, dim=0),
    "linear": lambda x: F.linear(x, A, HEIGHTS[:4]),
    "linear of rows": lambda x: F.linear(x[None], A, HEIGHTS[:4]),
    "linear of blocks": lambda x: F.linear(x[None, None], A),
    "einsum": lambda x: torch.einsum("ij,j->i", A, x),
    "einsum of three": lambda x: torch.einsum("i,j,kj->ki", x, x, A),
    "einsum with dots": lambda x: torch.einsum("...i,ij->...j", x[None, :4], B),
    "bilinear": lambda x: torch.einsum("i,kij,j->k", x, WIDE, x),
    "outer": lambda x: torch.outer(x, x).sum(0),
    "tensordot": lambda x: torch.tensordot(A, x, 1), "inner": lambda x: torch.inner(A, x),
    "vdot": lambda x: x.vdot(x.sin()),
    "vecdot": lambda x: torch.linalg.vecdot(x, x.cos()),
    "cross": lambda x: torch.linalg.cross(x[:3], x[1:4]),
    "crosses": lambda x: torch.linalg.cross(x[:6].reshape(2, 3), x[None, 3:6]),
    "addmv": lambda x: torch.addmv(HEIGHTS[:4], A, x),
    "torch.cross": lambda x: torch.cross(x[:3], x[1:4], dim=-1),
    "addr": lambda x: torch.addr(torch.eye(7), x, x).sum(0),
    "multi_dot": lambda x: torch.linalg.multi_dot((A, torch.outer(x, x), A.mT))[0],
    "four axes": lambda x: torch.outer(x[:4], x[:4]).expand(2, 3, 4, 4) @ B,
    "matrix_power": lambda x: torch.linalg.matrix_power(torch.outer(x[:3], x[1:4]) + torch.eye(3),
                                                        3)[0],
    "det": lambda x: torch.linalg.det(torch.outer(x[:3], x[1:4]) + torch.eye(3)),
    "slogdet": lambda x: torch.linalg.slogdet(torch.outer(x[:3], x[:3]) + torch.eye(3))[1],
    "inv": lambda x: torch.linalg.inv(torch.outer(x[:3], x[:3]) + 3 * torch.eye(3))[0],
    "solve": lambda x: torch.linalg.solve(torch.outer(x[:3], x[:3]) + 3 * torch.eye(3), x[:3]),
    "kron": lambda x: torch.kron(x[:2], x[2:4]), "trace": lambda x: torch.trace(torch.outer(x, x)),
    "cumprod": lambda x: x.cumprod(0), "cumsum": lambda x: x.cumsum(0), "diff": lambda x: x.diff(),
    "roll": lambda x: x.roll(2),
    "sums of one number": lambda x: x[2].sum() * x[1].mean(),
    "amax": lambda x: x.amax(), "max of an axis": lambda x: x.reshape(1, 7).max(-1).values,
    "min": lambda x: x.min(),
    "where it is largest": lambda x: x[x.argmax()],
    "where it is smallest": lambda x: x[..., x.argmin()],
    "distance": lambda x: F.pairwise_distance(x[None, :3], x[None, 3:6]),
    "trapezoid": torch.trapezoid, "huber": lambda x: F.huber_loss(x, torch.zeros(7)),
    "glu": lambda x: F.glu(x[:6]),
    "scatter": lambda x: torch.zeros(9).scatter(0, torch.arange(7), x),
    "unfold": lambda x: x.unfold(0, 3, 1).sum(-1),
    "scatter_add": lambda x: torch.zeros(9).scatter_add(0, torch.tensor([0, 0, 1, 2, 3, 4, 5]), x),
    "index_add": lambda x: torch.zeros(3).index_add(0, torch.tensor([0, 0, 1, 2, 1, 1, 2]), x),
    "embedding": lambda x: F.embedding((x[:2].abs() * 3).long().clamp(0, 3), A) * x[0],
    "attention": lambda x: F.scaled_dot_product_attention(*[x[None, :6].reshape(1, 2, 3)] * 3),
    "meshgrid": lambda x: torch.stack(torch.meshgrid(x[:2], x[2:4], indexing="ij")),
}
# fmt: on


@pytest.mark.parametrize("name", VECTOR)
def test_functions_of_vectors_are_torchs(name):
    check(VECTOR[name], torch.randn(3, 7, generator=DRAWN))


def check(function, x):
    """Of each row of x (rows, n): the traced function, its derivative, and torch's derivative of
    it, traced.
    """
    rows = x.clone().requires_grad_()
    expected = torch.stack([function(row) for row in rows])
    g = torch.randn(expected.shape, generator=DRAWN)
    traced = trace(lambda x: function(x), {"x": x[0]})
    backward = trace(lambda x, g: torch.func.vjp(function, x)[1](g)[0], {"x": x[0], "g": g[0]})
    assert_close(
        evaluate(traced, {"x": x})["out"], expected.detach(), rtol=1e-12, atol=1e-13, equal_nan=True
    )
    slope = (
        torch.autograd.grad(expected, rows, g)[0] if expected.requires_grad else torch.zeros_like(x)
    )
    found = evaluate(vjp(traced, ["x"]), {"x": x, bar("out"): g})[bar("x")]
    assert_close(found, slope, rtol=1e-11, atol=1e-12, equal_nan=True)
    assert_close(
        evaluate(backward, {"x": x, "g": g})["out"], slope, rtol=1e-11, atol=1e-12, equal_nan=True
    )


HELD, LISTED = torch.zeros(3), torch.arange(300.0)


def counting(x):
    HELD.add_(1)
    return x


def writing(x):
    HELD[:1] = x[:1]
    return x


@pytest.mark.parametrize(
    ("function", "said"),
    [
        (lambda x: x + torch.randn(3), "random numbers were drawn by aten.randn"),
        (lambda x: x.normal_(), "random numbers were drawn by aten.normal_"),
        (F.dropout, "random numbers were drawn by"),
        (lambda x: x * torch.rand_like(x), "random numbers were drawn by"),
        (counting, "writes to a tensor that the function did"),
        (writing, "writes to a tensor that the function did not make"),
        (lambda x: x.half() * 1, "torch.float64 or torch.float32"),
        (lambda x: x.sort().values, "aten.sort.* torch.maximum and torch.minimum are wanted"),
        (lambda x: LISTED[x.long()], "a table of 300 entries; at most 256 are wanted"),
        (
            lambda x: torch.linalg.matrix_exp(x * torch.eye(3)),
            "the closed form of a rotation, by sin and cos, is wanted",
        ),
        (lambda x: torch.exp(1j * x).real, "real numbers"),
        (lambda x: torch.lgamma(x), "a polynomial, or a table"),
        (
            lambda x: F.batch_norm(x.expand(2, 3), torch.zeros(3), torch.ones(3), training=True),
            "eval mode is wanted",
        ),
        (
            lambda x: torch.linalg.eigvalsh(x * torch.eye(3)),
            "a closed form of a small matrix is wanted",
        ),
    ],
)
def test_what_has_no_graph_is_refused_with_what_to_write(function, said):
    with pytest.raises(NotTraceable, match=said):
        trace(lambda x: function(x), {"x": torch.tensor([0.2, 0.3, 0.5])})
    assert not HELD.any()
