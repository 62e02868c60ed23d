"""Ways in which a function holds a number: a run of another number is never answered from the
folder of the first.

Each way gives a function, of theta times its number, and what puts another number there.
"""

import dataclasses
import functools
import math
import types
import warnings

import pytest
import torch

import torchbeam as tb

WAYS = {}


def way(give):
    WAYS[give.__name__] = give
    return give


def module_of(code, **numbers):
    """A user's module from its source."""
    module = types.ModuleType("users")
    exec(code, vars(module))
    vars(module).update(numbers)
    return module


class Spring:
    k = 2.0

    def __init__(self, k=2.0):
        self.k = k

    def __call__(self, theta):
        return self.k * theta.sum(-1)

    def force(self, theta):
        return self.k * theta.sum(-1)

    @property
    def twice(self):
        return 2 * self.k


class Slotted:
    __slots__ = ("k",)

    def __call__(self, theta):
        return self.k * theta.sum(-1)


@dataclasses.dataclass
class Record:
    k: float = 2.0

    def __call__(self, theta):
        return self.k * getattr(self, "factor", 1.0) * theta.sum(-1)


class Network(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.weight = torch.nn.Parameter(torch.full((2,), 2.0, dtype=torch.float64))
        self.register_buffer("shift", torch.ones(2, dtype=torch.float64))
        self.k = 2.0

    def forward(self, theta):
        return self.k * (self.weight * theta + self.shift).sum(-1).detach()


class Table(dict):
    """A dictionary with attributes."""


class Scale(float):
    """A number with a method."""


def attribute_of(x):
    """What reads an attribute of x, and what changes it."""
    x.k = 2.0
    return lambda theta: x.k * theta.sum(-1), lambda: setattr(x, "k", 3.0)


def itself(x, name="k", holder=None):
    """A function that knows its number by itself, or in a holder."""
    return x, lambda: setattr(holder or x, name, 3.0)


ASKED = "def function(theta):\n    return k * theta.sum(-1)"
NO_NAME = "k = 2.0\nclass Of:\n    def __call__(self, theta):\n        return k * theta.sum(-1)"


@way
def closure():
    k = 2.0

    def function(theta):
        return k * theta.sum(-1)

    def change():
        nonlocal k
        k = 3.0

    return function, change


@way
def default():
    def function(theta, k=(2.0,)):
        return k[0] * theta.sum(-1)

    return function, lambda: setattr(function, "__defaults__", ((3.0,),))


@way
def keyword_default():
    def function(theta, *, k=2.0):
        return k * theta.sum(-1)

    return function, lambda: setattr(function, "__kwdefaults__", {"k": 3.0})


@way
def global_of_a_namespace_without_a_name():
    names = {}
    exec(NO_NAME, names)
    return names["Of"](), lambda: names.update(k=3.0)


@way
def attribute_of_a_function():
    def function(theta):
        return function.k * theta.sum(-1)

    function.k = 2.0
    return itself(function)


@way
def attribute_of_another_function():
    def other(theta):
        return theta.sum(-1)

    other.k = 2.0
    return lambda theta: other.k * other(theta), lambda: setattr(other, "k", 3.0)


@way
def attribute_of_a_cached_function():
    other = functools.lru_cache(lambda: 1.0)
    other.k = 2.0
    functions = [other]
    return lambda theta: functions[0].k * theta.sum(-1), lambda: setattr(other, "k", 3.0)


@way
def attribute_of_a_method():
    class Of:
        def __call__(self, theta):
            return Of.__call__.k * theta.sum(-1)

    Of.__call__.k = 2.0
    return itself(Of(), holder=Of.__call__)


@way
def nested_function():
    k = [2.0]

    def function(theta):
        def inner(x):
            return k[0] * x

        return inner(theta).sum(-1)

    return function, lambda: k.__setitem__(0, 3.0)


@way
def wrapped_function():
    k = [2.0]

    def inner(theta):
        return k[0] * theta.sum(-1)

    @functools.wraps(inner)
    def function(theta):
        return inner(theta)

    return function, lambda: k.__setitem__(0, 3.0)


@way
def property_of_an_object():
    spring = Spring()
    return lambda theta: spring.twice * theta.sum(-1), lambda: setattr(spring, "k", 3.0)


@way
def attribute_of_a_class():
    class Of:
        k = 2.0

        def __call__(self, theta):
            return self.k * theta.sum(-1)

    return itself(Of(), holder=Of)


@way
def class_method():
    class Of:
        k = 2.0

        @classmethod
        def function(cls, theta):
            return cls.k * theta.sum(-1)

    return itself(Of.function, holder=Of)


@way
def attribute_of_a_partial():
    function = functools.partial(lambda theta: function.k * theta.sum(-1))
    function.k = 2.0
    return itself(function)


@way
def dispatched_function():
    @functools.singledispatch
    def other(x):
        return x

    other.register(torch.Tensor, lambda x: 2 * x)
    return lambda theta: other(theta.sum(-1)), lambda: other.register(torch.Tensor, lambda x: 3 * x)


@way
def module_by_a_word():
    users = module_of("", k=2.0)
    return lambda theta: getattr(users, "k") * theta.sum(-1), lambda: setattr(users, "k", 3.0)  # noqa: B009


@way
def function_put_on_a_part_of_torch():
    part, name = torch.linalg, "users_k"
    part.users_k = lambda x: 2 * x
    return lambda theta: torch.linalg.users_k(theta.sum(-1)), lambda: setattr(
        part, name, lambda x: 3 * x
    )


def put_on(place, function):
    place.users_k = 2.0
    return function, lambda: setattr(place, "users_k", 3.0)


def in_a_list(k):
    return lambda theta: k[0] * theta.sum(-1), lambda: k.__setitem__(0, 3.0)


def in_a_tensor(k):
    return lambda theta: k * theta.sum(-1), lambda: k.fill_(3.0)


def in_a_dictionary(k):
    return lambda theta: k["k"] * theta.sum(-1), lambda: k.update(k=3.0)


def by_argument(k):
    return functools.partial(lambda theta, k: k["k"] * theta.sum(-1), k=k), lambda: k.update(k=3.0)


def as_global(names):
    return names["function"], lambda: names.update(k=3.0)


def of_module(users):
    return lambda theta: users.function(theta), lambda: setattr(users, "k", 3.0)


def of_modules(users):
    return lambda theta: users[0].k * theta.sum(-1), lambda: setattr(users[0], "k", 3.0)


def slot():
    slotted = Slotted()
    slotted.k = 2.0
    return itself(slotted)


def factor():
    record = Record()
    record.factor = 2.0
    return itself(record, "factor")


def of_network(make, change):
    network = Network()
    return make(network), lambda: change(network)


# fmt: off
WAYS |= {
    "list in a closure": lambda: in_a_list([2.0]),
    "tensor written in place": lambda: in_a_tensor(torch.tensor(2.0)),
    "dictionary in a closure": lambda: in_a_dictionary({"k": 2.0}),
    "argument of a partial": lambda: by_argument({"k": 2.0}),
    "global": lambda: as_global(vars(module_of(ASKED, k=2.0))),
    "global of a function of a module": lambda: of_module(module_of(ASKED, k=2.0)),
    "module in a list": lambda: of_modules([module_of("", k=2.0)]),
    **{f"attribute of {name}": lambda make=make: attribute_of(make()) for name, make in {
        "a tensor": lambda: torch.tensor(1.0), "a number": lambda: Scale(1.0),
        "a dictionary": Table, "a namespace": types.SimpleNamespace,
        "a module": lambda: module_of("")}.items()},
    "attribute of an object": lambda: itself(Spring()),
    "field of a dataclass": lambda: itself(Record()), "attribute of a dataclass": factor,
    "slot": slot,
    "attribute put on torch": lambda: put_on(torch, lambda theta: torch.users_k * theta.sum(-1)),
    "attribute put on math": lambda: put_on(math, lambda theta: math.users_k * theta.sum(-1)),
    "parameter of a network": lambda: of_network(lambda net: net,
                                                 lambda net: net.weight.data.mul_(2)),
    "buffer of a network": lambda: of_network(lambda net: net.forward,
                                              lambda net: net.shift.mul_(2)),
    "attribute of a network": lambda: of_network(lambda net: lambda theta: net(theta),
                                                 lambda net: setattr(net, "k", 3.0)),
    "hook of a network": lambda: of_network(
        lambda net: net, lambda net: net.register_forward_hook(lambda own, given, y: 2 * y)),
}
# fmt: on


@way
def bound_method():
    spring = Spring()
    return itself(spring.force, holder=spring)


@way
def attribute_of_a_metaclass():
    class Meta(type):
        k = 2.0

    class Of(metaclass=Meta):
        pass

    return lambda theta: Of.k * theta.sum(-1), lambda: setattr(Meta, "k", 3.0)


@pytest.fixture(autouse=True)
def as_it_was():
    yield
    for place in (torch, torch.linalg, math):
        vars(place).pop("users_k", None)


# of which it is said that they are not seen
UNSEEN = {
    "global_of_a_namespace_without_a_name",
    "attribute_of_a_cached_function",
    "dispatched_function",
    "module_by_a_word",
}


@pytest.mark.parametrize("name", WAYS)
def test_another_number(name, tmp_path):
    """Unchanged: from the folder, which is not written to; changed: refused there, and another
    answer elsewhere. What is not seen is asked a version for.
    """
    function, change = WAYS[name]()

    def run(folder="there", **version):
        return tb.monte_carlo(
            function,
            {"a": (0.0, 1.0), "b": (5.0, 6.0)},
            16,
            chunk=8,
            out=tmp_path / folder,
            **version,
        ).y

    def written():
        return {
            path: path.stat().st_mtime_ns
            for path in (tmp_path / "there").rglob("*")
            if path.suffix == ".pt"
        }

    if name in UNSEEN:
        with pytest.warns(FutureWarning, match="may change unseen.*version= is wanted"):
            first = run("unseen")
        change()
        assert not torch.equal(run(version=1), first)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first, files = run(), written()
    assert files and torch.equal(run(), first) and written() == files
    change()
    with pytest.raises(ValueError, match="another function was given"):
        run()
    assert not torch.equal(run("elsewhere"), first)
