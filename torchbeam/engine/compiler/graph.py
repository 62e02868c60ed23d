"""Graph of scalar operations: what a function of small tensors does, number by number.

A node is an integer; the nodes that it reads have smaller ones. Equal nodes are one node. A node is
a number, or a truth value; the two never mix but by `number` and `truth`. What is made of constants
is computed at once, and rules of arithmetic shorten the rest. They change results by rounding at
most, with two exceptions, both taken because structural zeros (of skew matrices, identities, absent
masses) are most of what local physics multiplies with:

    0 x = 0 and 0 / x = 0
    for every x: a NaN or inf in x does not come through a factor that is zero by structure
    -0 = 0                    signs of zeros are not kept

x - x, x / x and x == x are left alone: the first is the test for NaN and inf.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Sequence

import numpy as np

# fmt: off
PLAIN = {  # of Python's numbers, with numpy's results
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "neg": operator.neg,
    "lt": operator.lt, "le": operator.le, "eq": operator.eq,
}
FOLDED: dict[str, Callable] = {
    **PLAIN, "div": np.divide, "sqrt": np.sqrt,
    "norm": np.sqrt, "sin": np.sin, "cos": np.cos, "atan2": np.arctan2, "exp": np.exp,
    "log": np.log, "tanh": np.tanh,
    "expm1": np.expm1, "log1p": np.log1p, "sinh": np.sinh, "cosh": np.cosh, "asinh": np.arcsinh,
    "acosh": np.arccosh,
    "atanh": np.arctanh, "erf": lambda x: math.erf(x), "erfc": lambda x: math.erfc(x),
    "pow": np.power, "abs": np.abs,
    "floor": np.floor, "round": np.rint, "max": lambda *x: np.max(x), "min": lambda *x: np.min(x),
    "and": np.logical_and, "or": np.logical_or, "not": np.logical_not,
    "exponent": lambda x: np.frexp(x)[1] - 1.0, "mantissa": lambda x: 2 * np.frexp(x)[0],
    "power2": np.exp2, "stop": np.positive,
}
# fmt: on
TRUTHS = {"lt", "le", "eq", "and", "or", "not"}
COMMUTATIVE = {"add", "mul", "eq", "and", "or", "max", "min"}


class Graph:
    """Nodes in lists that only grow. Of node n: ops[n] its operation, args[n] the nodes it reads,
    values[n] the value of a constant, or (field, component) of an input.

    Operations: const, input; add, sub, mul, div, neg, abs, sqrt, norm (the square root of a sum of
    squares, whose derivative at 0 is 0), sin, cos, atan2, exp, log, tanh, expm1, log1p, sinh, cosh,
    asinh, acosh, atanh, erf, erfc, pow, floor, round (half to even); max, min of any number
    (NaN wins); lt, le, eq; and, or, not; select(truth, a, b). Of a normal number, to lower
    functions: exponent (floor of log2|x|) and mantissa (in [1, 2)); power2(k) = 2^k of an integral
    k from -1022 to 1023. pick(k, x0, x1, ...): the number xk, of a whole k that there is. stop(x),
    which is x, and whose derivative is 0. While tracing: factor(x), an element of the factors of a
    matrix, which stands for that of the matrix.
    """

    def __init__(self) -> None:
        self.ops: list[str] = []
        self.args: list[tuple[int, ...]] = []
        self.values: list[float | bool | tuple[str, int] | None] = []
        self.truths: list[bool] = []
        self._known: dict[tuple, int] = {}
        self._rules = {
            op: getattr(self, f"_{op}")
            for op in (*FOLDED, "select", "pick")
            if hasattr(self, f"_{op}")
        }
        self.zero = self.const(0.0)  # node 0
        self.one = self.const(1.0)

    def copied(self) -> Graph:
        """The same nodes, to which others may be added."""
        graph = Graph()
        for name in ("ops", "args", "values", "truths", "_known"):
            setattr(graph, name, getattr(self, name).copy())
        return graph

    def _intern(
        self,
        key: tuple,
        op: str,
        args: tuple[int, ...],
        value: float | bool | tuple[str, int] | None,
        truth: bool,
    ) -> int:
        node = self._known.get(key)
        if node is None:
            node = self._known[key] = len(self.ops)
            self.ops.append(op)
            self.args.append(args)
            self.values.append(value)
            self.truths.append(truth)
        return node

    def const(self, value: float | bool) -> int:
        if isinstance(value, (bool, np.bool_)):
            return self._intern(("const", bool(value)), "const", (), bool(value), True)
        value = float(value) + 0.0  # no -0
        key = ("number", value if value == value else "nan")
        return self._intern(key, "const", (), value, False)

    def input(self, field: str, component: int) -> int:
        return self._intern(("input", field, component), "input", (), (field, component), False)

    def is_const(self, x: int) -> bool:
        return self.ops[x] == "const"

    def make(self, op: str, *args: int) -> int:
        """The node of an operation, or a shorter one that is equal."""
        ops = self.ops
        if ops[args[-1]] == ops[args[0]] == "const" and op in FOLDED:
            if len(args) < 3 or all(ops[x] == "const" for x in args):
                return self.const(self._folded(op, [self.values[x] for x in args]))
        rule = self._rules.get(op)
        simpler = None if rule is None else rule(*args)
        if simpler is not None:
            return simpler
        if op in COMMUTATIVE:
            args = tuple(sorted(args))
        return self._intern(
            (op, args), op, args, None, op in TRUTHS or (op == "select" and self.truths[args[1]])
        )

    @staticmethod
    def _folded(op: str, values: list[float | bool]) -> float | bool:
        if op in PLAIN:
            return PLAIN[op](*values)
        with np.errstate(all="ignore"):
            result = FOLDED[op](*(x if isinstance(x, bool) else np.float64(x) for x in values))
        return bool(result) if op in TRUTHS else float(result)

    def again(
        self, op: str, args: Sequence[int], value: float | bool | tuple[str, int] | None
    ) -> int:
        """A node of another graph, with the nodes here that its own are."""
        return (
            self.const(value)
            if op == "const"
            else self.input(*value)
            if op == "input"
            else self.make(op, *args)
        )

    # Rules: a node, or None where there is nothing shorter

    def _add(self, a: int, b: int) -> int | None:
        if self.zero in (a, b):
            return b if a == self.zero else a
        if self.ops[b] == "neg":
            return self.make("sub", a, self.args[b][0])
        if self.ops[a] == "neg":
            return self.make("sub", b, self.args[a][0])
        if self.ops[a] == self.ops[b] == "select" and self.args[a][0] == self.args[b][0]:
            (truth, *xs), (_, *ys) = self.args[a], self.args[b]
            if all(self.zero in pair for pair in zip(xs, ys, strict=True)):
                return self.make(
                    "select", truth, *(self.make("add", *pair) for pair in zip(xs, ys, strict=True))
                )
        return None

    def _sub(self, a: int, b: int) -> int | None:
        if self.zero in (a, b):
            return a if b == self.zero else self.make("neg", b)
        if self.ops[b] == "neg":
            return self.make("add", a, self.args[b][0])
        if self.ops[a] == "neg":
            return self.make("neg", self.make("add", self.args[a][0], b))
        return None

    def _mul(self, a: int, b: int) -> int | None:
        if self.ops[b] == "const":
            a, b = b, a
        if self.ops[a] == "const":
            value = self.values[a]
            if value in (0.0, 1.0):
                return a if value == 0 else b
            if value == -1:
                return self.make("neg", b)
            if self.ops[b] == "neg":
                return self.make("mul", self.const(-value), self.args[b][0])
            if self.ops[b] == "mul" and self.ops[self.args[b][0]] == "const":
                inner, x = self.args[b]
                if _power_of_two(value) or _power_of_two(self.values[inner]):
                    return self.make("mul", self.const(value * self.values[inner]), x)
            # the constant first, whichever is older
            return self._intern(("mul", (a, b)), "mul", (a, b), None, False)
        for x, y in ((a, b), (b, a)):
            if self.ops[x] == "neg":
                return self.make("neg", self.make("mul", self.args[x][0], y))
        return None

    def _div(self, a: int, b: int) -> int | None:
        if a == self.zero or b == self.one:
            return a
        if self.ops[b] == "const" and _power_of_two(self.values[b]):
            return self.make("mul", self.const(1 / self.values[b]), a)
        for place, x in enumerate((a, b)):
            if self.ops[x] == "neg":
                parts = [a, b]
                parts[place] = self.args[x][0]
                return self.make("neg", self.make("div", *parts))
        return None

    def _stop(self, a: int) -> int | None:
        return a if self.truths[a] or self.ops[a] == "stop" else None

    def _neg(self, a: int) -> int | None:
        if self.ops[a] == "neg":
            return self.args[a][0]
        if self.ops[a] == "sub":
            return self.make("sub", *reversed(self.args[a]))
        if self.ops[a] == "mul" and self.ops[self.args[a][0]] == "const":
            return self.make("mul", self.const(-self.values[self.args[a][0]]), self.args[a][1])
        return None

    def _abs(self, a: int) -> int | None:
        return (
            self.make("abs", self.args[a][0])
            if self.ops[a] == "neg"
            else a
            if self.ops[a] in ("abs", "sqrt")
            else None
        )

    def _max(self, *args: int, op: str = "max") -> int | None:
        distinct = tuple(dict.fromkeys(args))
        return (
            None
            if len(distinct) == len(args) > 1
            else distinct[0]
            if len(distinct) == 1
            else self.make(op, *distinct)
        )

    def _min(self, *args: int) -> int | None:
        return self._max(*args, op="min")

    def _lt(self, a: int, b: int) -> int | None:
        return self.const(False) if a == b else None

    def _not(self, a: int) -> int | None:
        return self.args[a][0] if self.ops[a] == "not" else None

    def _and(self, a: int, b: int) -> int | None:
        for x, y in ((a, b), (b, a)):
            if self.ops[x] == "const":
                return y if self.values[x] else x
        return a if a == b else None

    def _or(self, a: int, b: int) -> int | None:
        for x, y in ((a, b), (b, a)):
            if self.ops[x] == "const":
                return x if self.values[x] else y
        return a if a == b else None

    def _select(self, truth: int, a: int, b: int) -> int | None:
        if self.ops[truth] == "const":
            return a if self.values[truth] else b
        if self.ops[truth] == "not":
            return self.make("select", self.args[truth][0], b, a)
        if self.ops[a] == "select" and self.args[a][0] == truth:
            return self.make("select", truth, self.args[a][1], b)
        if self.ops[b] == "select" and self.args[b][0] == truth:
            return self.make("select", truth, a, self.args[b][2])
        if a == b:
            return a
        if self.truths[a] and self.ops[a] == self.ops[b] == "const":
            return truth if self.values[a] else self.make("not", truth)
        return None

    def _pick(self, place: int, *xs: int) -> int | None:
        if self.is_const(place):
            return xs[int(self.values[place])]
        return xs[0] if len(set(xs)) == 1 else None

    # What is made of several nodes

    def number(self, x: int) -> int:
        """1 for true, 0 for false; a number as it is."""
        return self.make("select", x, self.one, self.zero) if self.truths[x] else x

    def truth(self, x: int) -> int:
        """Whether a number is not zero; a truth value as it is."""
        return x if self.truths[x] else self.make("not", self.make("eq", x, self.zero))

    def total(self, terms: Iterable[int]) -> int:
        result = self.zero
        for x in terms:
            result = self.make("add", result, x)
        return result

    def dot(self, xs: Iterable[int], ys: Iterable[int]) -> int:
        pairs = zip(xs, ys, strict=True)
        return self.total(self.make("mul", x, y) for x, y in pairs if x and y)  # 0 is zero

    def live(
        self, ends: Iterable[int], known: frozenset[int] | set[int] = frozenset()
    ) -> list[int]:
        """What the nodes `ends` need, themselves among it, in order; of what is known nothing is
        needed.
        """
        live, args = set(ends), self.args
        todo = list(live)
        while todo:
            node = todo.pop()
            if node not in known:
                for x in args[node]:
                    if x not in live:
                        live.add(x)
                        todo.append(x)
        return sorted(live)


def _power_of_two(value: float) -> bool:
    return (
        math.isfinite(value)
        and value != 0
        and abs(math.frexp(value)[0]) == 0.5
        and 1e-300 < abs(value) < 1e300
    )
