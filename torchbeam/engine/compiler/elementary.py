"""Elementary functions as graphs of arithmetic (`RULES`), in float64, for any number of lanes at
once.

Errors in units in the last place, with and without fused products:

    sin, cos    < 1 for |x| <= 1e6 (reduced by Cody and Waite's three parts of pi/2, with its
                remainder); beyond it the error grows, and inf gives NaN
    atan2       < 2, the signs of zeros aside: atan2(0, 0) = 0 and atan2(+-0, x < 0) = pi
    exp         < 1; above 709.79 inf, below -745.2 zero
    log         < 1; of 0 -inf, of what is negative NaN
    tanh        < 2
    expm1, log1p, sinh, cosh, asinh, acosh, atanh   < 4; sinh and cosh are inf above 709.79
    erf         < 2
    erfc        < 8, but for numbers below 1e-290
    pow         < 2 + |y log x|: x^y is exp(y log|x|); 0^0 = 1, and of x < 0 NaN, unless y is a
                whole number

Polynomials interpolate at Chebyshev points of the reduced interval (to 1e-17 of the result).
Reductions and compensated sums as in W. J. Cody and W. Waite, Software Manual for the Elementary
Functions, 1980, and P. T. P. Tang, ACM TOMS 15 (1989).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import cache

from .function import Function, Output
from .graph import Graph

# two of 33 bits: exact times 2^20
HALF_PI = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
QUARTER_PI = (0.7853981633974483, 3.061616997868383e-17)  # the first of 50 bits: exact times 3
LOG_2 = (0.6931471803691238, 1.9082149292705877e-10)  # the first of 32 bits
# (sin(r)/r - 1)/z and (cos(r) - 1 + z/2)/z^2 by z = r^2, |r| <= pi/4
SIN = (
    -0.16666666666666666,
    0.008333333333333331,
    -0.00019841269841265063,
    2.7557319219337312e-06,
    -2.5052106231802837e-08,
    1.6058531516797758e-10,
    -7.586691094197958e-13,
)
COS = (
    0.041666666666666664,
    -0.0013888888888887398,
    2.480158729876456e-05,
    -2.7557317271145144e-07,
    2.087614614655861e-09,
    -1.1382623647474604e-11,
)
# (atan(t)/t - 1)/z by z = t^2, |t| <= tan(pi/8)
ATAN = (
    -0.3333333333333333,
    0.19999999999999804,
    -0.14285714285659779,
    0.11111111105150588,
    -0.09090908753259112,
    0.07692296368042296,
    -0.0666642476020052,
    0.05878927554473807,
    -0.05230443640686948,
    0.045515447340221615,
    -0.03456931506332609,
    0.016284375050043393,
)
# (exp(r) - 1 - r)/r^2, |r| <= log(2)/2
EXP = (
    0.5000000000000001,
    0.16666666666666669,
    0.04166666666662413,
    0.008333333333330062,
    0.0013888888917213717,
    0.00019841269863053618,
    2.4801521295954376e-05,
    2.7557268459997064e-06,
    2.7620088445409746e-07,
    2.510038549551032e-08,
)
# (2 atanh(s) - 2 s)/s^3 by z = s^2, s = (m - 1)/(m + 1), 1/sqrt(2) <= m <= sqrt(2)
LOG = (
    0.666666666666667,
    0.39999999999899444,
    0.2857142862600327,
    0.22222211130259878,
    0.18182889455674947,
    0.15331710618210773,
    0.14616585424888623,
)
# (h/tanh(h) - 1)/z by z = h^2, |h| <= log(2)/4
COTH = (
    0.3333333333333332,
    -0.02222222222205159,
    0.0021164020709329144,
    -0.00021163596927886233,
    2.1216099445943716e-05,
)

# (erf(x)/x - 1) by z = x^2, |x| <= 1
ERF = (
    0.1283791670955126,
    -0.37612638903183754,
    0.1128379167095512,
    -0.02686617064512984,
    0.0052239776254232985,
    -0.000854832702193483,
    0.00012055332902888736,
    -1.4925647567519332e-05,
    1.6462045441468418e-06,
    -1.6364642158167616e-07,
    1.4792401209404813e-08,
    -1.216456005728345e-09,
    8.709045129053106e-11,
    -4.230945824295338e-12,
)
# x exp(x^2) erfc(x) by u = (x - 2)/(x + 2), x >= 1
# fmt: off
ERFC = (0.5107913526210115, 0.1672110104141063, -0.20384429592887915, 0.12151493052455939,
        -0.02897644669799631,
        -0.007515738408858598, 0.004784898551337755, 0.0011266579427659145, -0.0007501843836468299,
        -0.00031435053213594867,
        8.941415921264815e-05, 8.93146521390379e-05, 6.2851111694745675e-06,
        -1.9040085378746178e-05, -8.770319326645683e-06,
        2.1437502696196356e-06, 1.9464797102460743e-06, -2.6852844588524854e-07,
        3.8729664775111e-06, -5.026768059014121e-06,
        2.1715574679016404e-06, -2.698937709226579e-07, -2.3635972958792134e-08)
# fmt: on


class _Number:
    """A node with the operators of arithmetic."""

    def __init__(self, graph: Graph, node: int) -> None:
        self.graph, self.node = graph, node

    def make(self, op: str, *others: _Number | float) -> _Number:
        rest = (x.node if isinstance(x, _Number) else self.graph.const(x) for x in others)
        return _Number(self.graph, self.graph.make(op, self.node, *rest))

    def __add__(self, other: _Number | float) -> _Number:
        return self.make("add", other)

    def __sub__(self, other: _Number | float) -> _Number:
        return self.make("sub", other)

    def __mul__(self, other: _Number | float) -> _Number:
        return self.make("mul", other)

    def __truediv__(self, other: _Number | float) -> _Number:
        return self.make("div", other)

    def __lt__(self, other: _Number | float) -> _Number:
        return self.make("lt", other)

    def __neg__(self) -> _Number:
        return self.make("neg")

    def where(self, a: _Number | float, b: _Number | float) -> _Number:
        """a where this is true, else b."""
        return self.make("select", a, b)

    def polynomial(self, coefficients: Sequence[float]) -> _Number:
        """Even and odd powers apart (Estrin's first step): half as deep as Horner's rule."""
        if len(coefficients) < 4:
            result = _Number(self.graph, self.graph.const(coefficients[-1]))
            for c in reversed(coefficients[:-1]):
                result = result * self + c
            return result
        square = self * self
        return square.polynomial(coefficients[1::2]) * self + square.polynomial(coefficients[::2])


def _sine(x: _Number, quarters: int) -> _Number:
    """sin(x + quarters pi/2)"""
    q = (x * (2 / math.pi)).make("round")
    exact = x - q * HALF_PI[0]
    head = exact - q * HALF_PI[1]
    low = (exact - head) - q * HALF_PI[1] - q * HALF_PI[2]
    r = head + low
    rest = (head - r) + low
    z = r * r
    half = z * 0.5
    near_one = -(half - 1.0)
    sine = r + (r * z * z.polynomial(SIN) + rest * near_one)
    cosine = near_one + ((-(near_one - 1.0) - half) + (z * z * z.polynomial(COS) - r * rest))
    n = q + float(quarters)
    quadrant = n - (n * 0.25).make("floor") * 4.0
    odd = (quadrant - (quadrant * 0.5).make("floor") * 2.0).make("eq", 1.0)
    value = odd.where(cosine, sine)
    return (quadrant < 2.0).where(value, -value)


def _arctangent(y: _Number, x: _Number) -> _Number:
    """The angle as base +- atan(t), base a multiple of pi/4 and |t| <= tan(pi/8)."""
    across, along = y.make("abs"), x.make("abs")
    large, small = along.make("max", across), along.make("min", across)
    both = small.make("eq", math.inf)
    steep, diagonal = along < across, (large * math.tan(math.pi / 8) < small).make("or", both)
    denominator = large.make("eq", 0.0).where(1.0, diagonal.where(large + small, large))
    t = diagonal.where(small - large, small) / denominator
    t = both.where(0.0, t)
    z = t * t
    angle = t + t * (z * z.polynomial(ATAN))
    quarters = diagonal.where(1.0, 0.0)
    quarters, angle = steep.where(-(quarters - 2.0), quarters), steep.where(-angle, angle)
    left = x < 0.0
    quarters, angle = left.where(-(quarters - 4.0), quarters), left.where(-angle, angle)
    angle = quarters * QUARTER_PI[0] + (angle + quarters * QUARTER_PI[1])
    return (y < 0.0).where(-angle, angle)


def _reduced(x: _Number) -> tuple[_Number, _Number, _Number]:
    """exp(x) - 1 of what is left of x beside k log(2); 2^k as a product: it may be too large, or
    too small, for one number.
    """
    x = (x < -800.0).where(-800.0, x)
    x = -((-x) < -800.0).where(-800.0, -x)
    k = (x * (1 / math.log(2))).make("round")
    r = x - k * LOG_2[0] - k * LOG_2[1]
    half = (k * 0.5).make("floor")
    return r * r * r.polynomial(EXP) + r, half.make("power2"), (k - half).make("power2")


def _exponential(x: _Number) -> _Number:
    small, one, other = _reduced(x)
    return (small + 1.0) * one * other


def _exponential_less_one(x: _Number) -> _Number:
    small, one, other = _reduced(x)
    near, far = small * one * other + (one * other - 1.0), (small + 1.0) * one * other
    return (x < 40.0).where(near, (x < math.inf).where(far, x))


def _logarithm(x: _Number) -> _Number:
    tiny = x < 2.0**-1022
    normal = tiny.where(x * 2.0**54, x)
    k, m = normal.make("exponent"), normal.make("mantissa")
    upper = m.make("lt", math.sqrt(2)).make("not")
    k, m = upper.where(k + 1.0, k), upper.where(m * 0.5, m)
    k = tiny.where(k - 54.0, k)
    f = m - 1.0
    s = f / (f + 2.0)
    z, half = s * s, f * f * 0.5
    value = k * LOG_2[0] - ((half - (s * (half + z * z.polynomial(LOG)) + k * LOG_2[1])) - f)
    value = (x < math.inf).where(value, x)
    return (x < 0.0).where(math.nan, x.make("eq", 0.0).where(-math.inf, value))


def _logarithm_of_one_more(x: _Number) -> _Number:
    """log(1 + x), with what 1 + x loses in the sum (W. Kahan)."""
    more = x + 1.0
    value = _logarithm(more) + (x - (more - 1.0)) / more
    return more.make("eq", 0.0).where(-math.inf, (x < math.inf).where(value, x))


def _hyperbolic_tangent(x: _Number) -> _Number:
    """tanh(a + h) = T + (1 - T^2) h/(h/tanh(h) + T h) with T = tanh(a), by a multiple a of
    log(2)/2: one formula for all sizes of x.
    """
    x = (x < -20.0).where(-20.0, x)
    x = -((-x) < -20.0).where(-20.0, -x)
    k = (x * (2 / math.log(2))).make("round")
    h = x - k * (LOG_2[0] / 2) - k * (LOG_2[1] / 2)
    power, z = k.make("power2"), h * h
    T = (power - 1.0) / (power + 1.0)
    return T - (T * T - 1.0) * h / (T * h + z * z.polynomial(COTH) + 1.0)


def _odd(rule: Callable[[_Number], _Number]) -> Callable[[_Number], _Number]:
    """A function with f(-x) = -f(x), from that of |x|."""

    def both(x: _Number) -> _Number:
        value = rule(x.make("abs"))
        return (x < 0.0).where(-value, value)

    return both


def _hyperbolic_sine(x: _Number) -> _Number:
    more = _exponential_less_one(x)
    return (x < 40.0).where((more + more / (more + 1.0)) * 0.5, more * 0.5)


def _hyperbolic_cosine(x: _Number) -> _Number:
    power = _exponential(x.make("abs"))
    return (power + _Number(x.graph, x.graph.one) / power) * 0.5


def _inverse_sine(x: _Number) -> _Number:
    square = x * x
    near = _logarithm_of_one_more(x + square / ((square + 1.0).make("sqrt") + 1.0))
    return (x < 1e8).where(near, _logarithm(x) + math.log(2))


def _inverse_cosine(x: _Number) -> _Number:
    above = x - 1.0
    near = _logarithm_of_one_more(above + (above * (above + 2.0)).make("sqrt"))
    return (x < 1e8).where(near, _logarithm(x) + math.log(2))


def _inverse_tangent(x: _Number) -> _Number:
    return _logarithm_of_one_more(x * 2.0 / -(x - 1.0)) * 0.5


def _error(x: _Number) -> _Number:
    """Of x >= 0."""
    z = x * x
    return (x < 1.0).where(x + x * z.polynomial(ERF), -(_beyond(x, _exponential(-z)) - 1.0))


def _complement(x: _Number) -> _Number:
    size, z = x.make("abs"), x * x
    size = (-size < -40.0).where(40.0, size)
    head = size * (2.0**27 + 1)
    head = head - (head - size)  # of 26 bits: its square is exact
    far = _beyond(
        size, _exponential(-(head * head)) * _exponential(-((size - head) * (size + head)))
    )
    far = (x < 0.0).where(-(far - 2.0), far)
    near = -((x + x * z.polynomial(ERF)) - 1.0)
    return (size < 1.0).where(
        (x < 0.5).where(near, -((x - 0.5) + (x * z.polynomial(ERF) - 0.5))), far
    )


def _beyond(x: _Number, power: _Number) -> _Number:
    """erfc(x) of x >= 1, from exp(-x^2)."""
    x = (-x < -40.0).where(40.0, x)
    return power * ((x - 2.0) / (x + 2.0)).polynomial(ERFC) / x


def _power(x: _Number, y: _Number) -> _Number:
    size = _exponential(y * _logarithm(x.make("abs")))
    whole = y.make("floor").make("eq", y)
    odd = (y * 0.5).make("floor").make("eq", y * 0.5).make("not")
    value = (x < 0.0).where(whole.where(odd.where(-size, size), math.nan), size)
    return y.make("eq", 0.0).where(1.0, value)


# fmt: off
RULES: dict[str, Callable[..., _Number]] = {
    "sin": lambda x: _sine(x, 0), "cos": lambda x: _sine(x, 1), "atan2": _arctangent,
    "exp": _exponential, "log": _logarithm,
    "tanh": _hyperbolic_tangent, "expm1": _exponential_less_one, "log1p": _logarithm_of_one_more,
    "pow": _power,
    "sinh": _odd(_hyperbolic_sine), "cosh": _hyperbolic_cosine, "asinh": _odd(_inverse_sine),
    "acosh": _inverse_cosine,
    "atanh": _odd(_inverse_tangent), "erf": _odd(_error), "erfc": _complement,
}
# fmt: on


@cache
def elementary(name: str) -> Function:
    """One of `RULES`: fields x (of atan2: y and x, of pow: x and y) of one component -> out."""
    graph = Graph()
    fields = {"atan2": ("y", "x"), "pow": ("x", "y")}.get(name, ("x",))
    args = [_Number(graph, graph.input(field, 0)) for field in fields]
    return Function(
        graph, {field: () for field in fields}, {"out": Output((), (RULES[name](*args).node,))}
    )
