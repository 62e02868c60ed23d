"""digests of dependencies: what makes a function another one, and what does not."""

import copy
import dataclasses
import functools
import math
import re
import time
import types

import numpy as np
import pytest
import torch

import torchbeam as tb
from torchbeam.core.function_dependencies import Dependencies


def digests(value):
    """Of what is seen whole."""
    around = Dependencies([("", lambda: value)], strict=False)
    assert not around.unseen
    return around.digests()


def function(code, name="f", **around):
    """A function from its source, with these globals."""
    space = {"__name__": "somewhere", "torch": torch, "math": math, **around}
    exec(compile(code, "somewhere.py", "exec"), space)
    return space[name]


CODE = "def f(x, by=2.0):\n    return by * x.sin() + 3"
CHANGED = {
    "constant": CODE.replace("+ 3", "+ 4"),
    "default": CODE.replace("by=2.0", "by=2.5"),
    "method": CODE.replace("sin", "cos"),
    "operation": CODE.replace("by * x", "by - x"),
    "tuple": CODE.replace("+ 3", "+ len((1, 2, 3))"),
    "inner": CODE.replace("by * x.sin()", "(lambda y: y)(x)"),
}


@pytest.mark.parametrize("name", CHANGED)
def test_another_code(name):
    assert digests(function(CODE)) != digests(function(CHANGED[name]))


def test_the_same_code():
    """Comments, empty lines, the text of a docstring, the file."""
    documented = CODE.replace("\n", '\n    "Once."\n', 1)
    assert digests(function(CODE)) == digests(
        function("# a comment\n\n" + CODE.replace("return", "\n    return"))
    )
    assert digests(function(documented)) == digests(function(documented.replace("Once", "Twice")))


def test_globals_and_helpers():
    """A global, a function that it calls, a global of that one, a module of the user's, an inner
    function's global.
    """

    def known(scale=1.0, power=2, inner=3.0):
        helper = function("def helper(x):\n    return scale * x", "helper", scale=scale)
        module = types.ModuleType("users")
        module.power, module.unused = power, object()
        return digests(
            function(
                "def f(x):\n    g = lambda y: y + inner\n    return helper(g(x)) ** users.power",
                helper=helper,
                users=module,
                inner=inner,
            )
        )

    base = known()
    assert base == known()
    for changed, part in (
        (dict(scale=2.0), "scale"),
        (dict(power=3), "users.power"),
        (dict(inner=4.0), "inner"),
    ):
        other = known(**changed)
        assert [name for name in base if base[name] != other[name]] == [part]


class Model:
    def __init__(self, stiffness):
        self.stiffness = stiffness

    def __call__(self, x):
        return self.stiffness * x

    @functools.cached_property
    def half(self):
        return self.stiffness / 2


@dataclasses.dataclass
class Record:
    a: float
    b: object = None


A, B = torch.tensor([1.0, 2.0]), torch.tensor([1.0, 2.0 + 1e-15 * 2])
# fmt: off
PAIRS = {
    "float": (1.0, 1.0 + 2e-16), "int for float": (1, 1.0), "text": ("a", "b"),
    "list": ([1, 2], [2, 1]),
    "dict": ({"a": 1}, {"a": 2}), "set": ({"a", "b"}, {"a", "c"}), "tensor": (A, B),
    "tensor's dtype": (A, A.float()),
    "tensor's shape": (A, A[None]),
    "array": (A.numpy(), B.numpy()), "callable": (Model(1.0), Model(2.0)),
    "method": (Model(1.0).__call__, Model(2.0).__call__),
    "partial": (functools.partial(torch.add, other=1), functools.partial(torch.add, other=2)),
    "dataclass": (Record(1.0), Record(1.0, Record(2.0))),
    "numpy's": (np.sin, np.cos), "torch's": (torch.sin, torch.cos),
    "built in": (math.sin, math.cos),
    "class": (Model, Record), "module": (torch.nn.Linear(2, 2), torch.nn.Linear(2, 2)),
    "distribution": (torch.distributions.Normal(0.0, 1.0), torch.distributions.Normal(0.0, 2.0)),
    "dtype": (torch.float32, torch.float64),
}
# fmt: on


@pytest.mark.parametrize("name", PAIRS)
def test_values(name):
    """Two that differ, each the same as itself, and as a copy."""
    a, b = PAIRS[name]
    assert digests(a) == digests(a) == digests(copy.deepcopy(a))
    assert digests(a) != digests(b)


def test_use_does_not_change():
    """What an object or a scene keeps for a second use."""
    model = Model(1.0)
    scene = tb.Scene(tb.Beam.straight(1.0, 2, tb.Section.from_stiffness(9.0, 9.0, 1.0, 1.0, 1.0)))
    before = digests(model), digests(lambda theta: scene)
    assert model.half and tb.equilibrium(scene) and tb.describe(scene)
    assert tb.simulate(scene, [0.0, 0.1], step=0.1)
    assert before == (digests(model), digests(lambda theta: scene))


def test_circles_end():
    ring = [1]
    ring.append(ring)
    other = [2]
    other.append(other)
    assert digests(ring) == digests(ring) != digests(other)


@pytest.mark.parametrize(
    "value",
    [np.random.default_rng(0), re.compile("a"), functools.lru_cache(function(CODE)), time.time],
)
def test_what_is_not_seen_is_named(value):
    assert Dependencies([("x", lambda: value)], strict=False).unseen


def test_what_is_installed_counts_by_its_name():
    """No walk through its code."""
    f = function("def f(x):\n    return pytest.approx(x)", pytest=pytest)
    assert digests(f).keys() == {"", "pytest"}


def test_a_variable_that_is_not_set_yet_is_named():
    def f(x):
        return later * x

    (unseen,) = Dependencies([("f", lambda: f)], strict=False).unseen
    assert unseen.startswith("'later'")
    later = 1.0
    assert not Dependencies([("f", lambda: f)], strict=False).unseen and f(later) == 1.0
