"""Dependencies of a function: numbers, tensors and functions around it are followed; what may
change unnoticed is refused.
"""

import functools
import math
import random
import time
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
import pytest
import torch

from torchbeam.core.function_dependencies import Dependencies, Unsteady

number, weight, log, counted = 2.0, torch.ones(2), [1.0], 0
free = torch.nn.Parameter(torch.ones(2))


@dataclass(frozen=True)
class Frozen:
    gain: float
    weight: torch.Tensor


@dataclass(frozen=True)
class Law:
    gain: float

    def force(self, x):
        return number * self.gain * x


class Pair(NamedTuple):
    gain: float
    limit: float

    @property
    def slope(self):
        return number * self.gain


@dataclass
class Settings:
    gain: float = 1.0


class Contact:
    """A wall, and what a function of it does not read."""

    def __init__(self):
        self.normal, self.stiffness, self.table = (
            torch.tensor([0.0, 1.0]),
            2.0,
            {"gap": [0.1, 0.2], "law": Law(3.0)},
        )
        self.draw, self.count = np.random.default_rng(), 0

    def push(self, x):
        normal = self.normal
        return self.stiffness * normal * (x - self.table["gap"][1]) * self.table["law"].gain

    def __call__(self, x, gain):
        return gain * self.push(x)

    def counted(self, x):
        self.count += 1
        return x


class Network(torch.nn.Module):
    """Of two layers and a number."""

    def __init__(self):
        super().__init__()
        self.layers, self.gain = (
            torch.nn.Sequential(torch.nn.Linear(2, 3), torch.nn.Tanh(), torch.nn.BatchNorm1d(3)),
            2.0,
        )

    def forward(self, x):
        return self.gain * self.layers(x)


contact, network = Contact(), Network().eval()
frozen, settings, array = Frozen(1.0, torch.ones(2)), Settings(), np.ones(2)
law, pair = Law(1.0), Pair(1.0, 2.0)


def helper(x):
    return number * x


def counts(x):
    global counted
    counted += 1
    return x


def closing(value):
    return lambda x: value * x


def around(function):
    return Dependencies([("function", lambda: function)])


@pytest.mark.parametrize(
    "function",
    [
        lambda x: math.sin(number) * torch.relu(x) + max(1.0, 2.0),
        lambda x: helper(x) @ weight,
        lambda x: frozen.gain * x + frozen.weight,
        lambda x: [y + 1 for y in x.unbind(-1)],
        functools.partial(lambda gain, x: gain * x, 3.0),
        closing((1.0, torch.ones(2))),
        torch.tanh,
        lambda x: settings.gain * x,
        lambda x: log[0] * x,
        lambda x: x + torch.as_tensor(array),
        lambda x: x + torch.as_tensor(array) * array.shape[0],
        closing({"a": 1.0}),
        lambda x: np.sin(1.0) * np.pi * x,
        lambda x: contact.push(x),
        lambda x: network(x),
        functools.partial(contact, gain=2.0),
    ],
)
def test_numbers_tensors_and_functions_are_steady(function):
    assert around(function).unchanged()


@pytest.mark.parametrize(
    "function, said",
    [
        (counts, "'counted', which counts writes to"),
        (lambda x: random.random() * x, r"'random' \(a module\)"),
        (lambda x: time.time() * x, r"'time' \(a module\)"),
        (lambda x: np.random.normal() * x, "normal"),  # noqa: NPY002
        (lambda x: np.load("file") * x, "'np.load'"),
        (lambda x: contact.counted(x), "'count', which counted writes to"),
        (lambda x: contact.draw.normal(x), "'contact.draw'"),
        (lambda x: Contact().push(x), "which __init__ writes to"),
        (lambda x: getattr(contact, number)(x), "'contact.draw'"),
        (lambda x: print(x) or x, "'print'"),
        (lambda x: x + nowhere, "'nowhere'"),  # noqa: F821
        (closing(torch.ones(2).sum), r"'value' \(builtin_function_or_method\)"),
    ],
)
def test_what_may_change_unnoticed_is_refused_by_name(function, said):
    with pytest.raises(Unsteady, match=said):
        around(function)


def test_changes_are_noticed_and_equal_surroundings_have_equal_keys(monkeypatch):
    """A number that another, equal one replaces has not changed; functions made anew by the same
    code are the same.
    """
    monkeypatch.setitem(globals(), "weight", torch.ones(2))
    found = around(lambda x: helper(x) * weight)
    monkeypatch.setitem(globals(), "number", float("2.0"))
    assert found.unchanged()
    monkeypatch.setitem(globals(), "number", 3.0)
    assert not found.unchanged()
    monkeypatch.setitem(globals(), "number", 2.0)
    assert found.unchanged()
    weight.mul_(2)
    assert not found.unchanged()
    first, again, other = (around(closing(value)).key for value in (1.0, 1.0, 2.0))
    assert first == again != other


@pytest.mark.parametrize(
    "change",
    [
        lambda: setattr(settings, "gain", 2.0),
        lambda: log.append(1.0),
        lambda: log.__setitem__(0, 2.0),
        lambda: array.fill(2.0),
        lambda: contact.table.update(gap=[0.0, 0.3]),
        lambda: contact.table["gap"].__setitem__(1, 0.3),
        lambda: setattr(contact, "normal", torch.ones(2)),
        lambda: contact.normal.mul_(2),
        lambda: contact.normal.requires_grad_(),
        lambda: setattr(contact, "stiffness", 1.0),
        lambda: network.train(),
        lambda: setattr(network, "gain", 1.0),
        lambda: network.layers.append(torch.nn.Tanh()),
        lambda: network.layers[0].register_forward_hook(print),
        lambda: setattr(network.layers[0], "weight", torch.nn.Parameter(torch.zeros(3, 2))),
    ],
    ids=range(15),
)
def test_changes_of_objects_lists_and_networks_are_noticed(monkeypatch, change):
    for name, new in (
        ("settings", Settings()),
        ("log", [1.0]),
        ("array", np.ones(2)),
        ("contact", Contact()),
        ("network", Network().eval()),
    ):
        monkeypatch.setitem(globals(), name, new)
    found = around(
        lambda x: (
            (settings.gain * contact.push(x) + torch.as_tensor(array)) * log[0] + network(x).sum()
        )
    )
    assert found.unchanged()
    change()
    assert not found.unchanged()


class Gain(float):
    """A number that holds more."""


class Count(int):
    pass


class Name(str):
    pass


class Table(dict):
    pass


class Material(Enum):
    STEEL = 1

    def gain(self):
        return number


def held(value, gain=1.0):
    value.gain = gain
    return value


HELD = {
    "tensor": torch.ones(2), "parameter": torch.nn.Parameter(torch.ones(2)), "float": Gain(2.0),
    "int": Count(2), "str": Name("two"), "dict": Table(two=2.0),
    "partial": functools.partial(max, 2.0), "member": Material.STEEL,
}  # fmt: skip


@pytest.mark.parametrize("value", HELD.values(), ids=HELD)
def test_what_numbers_words_and_tensors_hold_beside_themselves_is_noticed(value):
    """An attribute that code names; another that it does not name may be what it likes."""
    held(value)
    found = around(closing((value,))), around((lambda value: lambda x: value.gain * x)(value))
    value.other = 1.0
    assert all(one.unchanged() for one in found)
    value.gain = 2.0
    assert [one.unchanged() for one in found] == [True, False]
    value.gain = 1.0
    assert all(one.unchanged() for one in found)


def test_numbers_and_words_of_ones_own_classes_are_told_apart(monkeypatch):
    """By themselves and by what they hold; the method of an enumeration's member is followed."""

    def key(value):
        kept.append(around(lambda x: value * value.gain))
        return kept[-1].key

    kept = []
    for make, other in ((Gain, 1.5), (Count, 3), (Name, "three")):
        one = make(other)
        assert key(held(make(other))) == key(held(make(other))) != key(held(make(2)))
        assert key(held(one)) != key(held(make(other), 2.0))
    found = around(lambda x: Material.STEEL.gain() * x)
    assert found.unchanged()
    monkeypatch.setitem(globals(), "number", 3.0)
    assert not found.unchanged()


@pytest.mark.parametrize("first, other", [(0.0, -0.0), (1, True), ((1,), (1.0,)), (1.0, 1 + 0j)])
def test_equal_numbers_may_be_others(first, other):
    cell = [first]
    found = around(lambda x: x + cell[0])
    cell[0] = other
    assert first == other and not found.unchanged()
    assert around(closing(first)).key != around(closing(other)).key
    cell[0] = math.nan
    found = around(lambda x: x + cell[0])
    cell[0] = float("nan")  # another object, and the same number
    assert found.unchanged()


@pytest.mark.parametrize("count", [3, 64, 65, 4096])
@pytest.mark.parametrize("dtype", [torch.float64, torch.int64, torch.bool])
def test_what_is_written_through_numpy_or_data_is_noticed(count, dtype):
    for write in (lambda x: x.numpy().fill(0), lambda x: x.data.fill_(0), replaced):
        x = torch.ones(count, dtype=dtype)
        found = around(closing(x))
        before = found.key
        assert found.unchanged()
        write(x)
        assert not found.unchanged() and around(closing(x)).key != before


def replaced(x):
    x.data = torch.zeros_like(x)


def test_of_many_numbers_the_next_look_notices():
    x = torch.ones(5000)
    f = closing(x)
    before = around(f)
    assert around(f).key == before.key
    x.numpy()[-1] = 0
    assert before.unchanged() and around(f).key != before.key


@pytest.mark.parametrize(
    "change",
    [
        lambda: torch.set_default_dtype(torch.float32),
        lambda: torch.set_num_threads(torch.get_num_threads() + 1),
        lambda: free.requires_grad_(False),
    ],
    ids=("default dtype", "threads", "gradient"),
)
def test_what_torch_goes_by_is_noticed(monkeypatch, change):
    monkeypatch.setitem(globals(), "free", torch.nn.Parameter(torch.ones(2)))
    reads = around(lambda x: x * torch.zeros(torch.get_num_threads()) * free.requires_grad)
    others = around(lambda x: x * free)
    assert reads.unchanged() and others.unchanged()
    change()
    assert not reads.unchanged()
    assert others.unchanged() == (torch.get_default_dtype() == torch.float64)


class Steel:
    """Numbers of a class, that makes no objects."""

    gain = 2.0


@pytest.mark.parametrize(
    "change",
    [
        lambda: setattr(Steel, "gain", 3.0),
        lambda: setattr(Settings, "gain", 3.0),
        lambda: setattr(Pair, "slope", property(lambda self: 1.0)),
        lambda: setattr(Law, "force", lambda self, x: x),
    ],
    ids=("number", "default", "property", "method"),
)
def test_classes_that_functions_name_and_make_objects_of(monkeypatch, change):
    """Plain classes, dataclasses, named tuples: what is changed of them is noticed."""
    for kind, name in ((Steel, "gain"), (Settings, "gain"), (Pair, "slope"), (Law, "force")):
        monkeypatch.setattr(kind, name, vars(kind)[name])  # is put back
    found = around(lambda x: Steel.gain * Settings().gain * Pair(x, 1.0).slope + Law.force(law, x))
    assert found.unchanged()
    change()
    assert not found.unchanged()


@pytest.mark.parametrize("module", [torch, torch.linalg, math])
def test_what_a_user_put_on_a_module_of_a_package_is_noticed(monkeypatch, module):
    """A number, a function and a tensor; what the module has by itself is none of it, but for
    numbers.
    """
    known = Dependencies([("f", lambda: torch.nn.functional.relu)])
    assert len(known.variables) == 2 and known.unchanged()  # one is the default dtype
    for first, other in (
        (2.0, 3.0),
        (lambda x: 2 * x, lambda x: 3 * x),
        (torch.ones(2), torch.ones(2)),
    ):
        monkeypatch.setattr(module, "users", first, raising=False)
        reads = {
            torch: lambda x: torch.users,
            torch.linalg: lambda x: torch.linalg.users,
            math: lambda x: math.users,
        }[module]
        known = Dependencies([("f", lambda reads=reads: reads)])
        assert known.unchanged()
        monkeypatch.setattr(module, "users", other)
        assert not known.unchanged()


def test_parameters_are_inputs_whatever_their_numbers():
    """An optimiser's step changes no program; another network of the same kind has the same; one of
    another size has not.
    """

    def key(value):
        kept.append(around(closing(value)))
        return kept[-1].key

    kept, one = [], Network().eval()
    before = key(one)
    assert [tuple(x.shape) for x in kept[0].inputs] == [(3, 2), (3,), (3,), (3,), (3,), (3,)]
    with torch.no_grad():
        one.layers[0].weight.mul_(2)
    assert kept[0].unchanged() and before == key(one) == key(Network().eval())
    other = Network().eval()
    other.gain = 3.0
    assert key(other) != before != key(Network())
    weight = torch.ones(2, requires_grad=True)
    assert around(closing(weight)).inputs[0] is weight and not around(closing(torch.ones(2))).inputs


@pytest.mark.parametrize("function", [lambda x: law.force(x), lambda x: pair.slope * x])
def test_methods_and_properties_of_what_cannot_change_are_followed(monkeypatch, function):
    found = around(function)
    assert found.unchanged()
    monkeypatch.setitem(globals(), "number", 3.0)
    assert not found.unchanged()


def test_functions_without_a_module_and_attributes_of_functions_are_followed():
    """exec gives its functions no module; what it is given are their globals."""
    known = {"gain": 1.0}
    exec("def spring(x): return gain * x", known)
    found = around(known["spring"])
    assert found.unchanged()
    known["gain"] = 2.0
    assert not found.unchanged()

    def spring(x):
        return spring.gain * x

    spring.gain = 1.0
    found = around(spring)
    assert found.unchanged()
    spring.gain = 2.0
    assert not found.unchanged()


def test_keys_tell_defaults_and_which_function_it_is_apart():
    """Two functions of the same code may have other defaults; a third may be the one or the other
    of them.
    """
    one, again, other = (
        around(lambda x, gain=gain, *, more=more: gain * more * x).key
        for gain, more in ((1.0, 1.0), (1.0, 1.0), (1.0, 2.0))
    )
    assert one == again != other

    def chosen(first, second, third):
        return lambda x: first(x) + second(x) * third(x)

    a, b = closing(1.0), closing(2.0)
    assert around(chosen(a, b, a)).key == around(chosen(a, b, a)).key != around(chosen(a, b, b)).key


def test_keys_are_of_what_tuples_dataclasses_and_small_tensors_hold():
    """Made anew with the same numbers they are the same; with others, or otherwise put together,
    they are not.
    """

    def key(value):
        kept.append(around(closing(value)))
        return kept[-1].key

    kept = []
    for make in (
        lambda x: (x, torch.ones(2)),
        lambda x: Frozen(x, torch.ones(2)),
        lambda x: torch.tensor([x, 1.0]),
    ):
        assert key(make(float("1.5"))) == key(make(float("1.5"))) != key(make(2.0))
    assert (
        len({key(value) for value in (((1.0, 2.0),), ((1.0,), 2.0), (1.0, 2.0), (1.0, (2.0,)))})
        == 4
    )
    assert key(torch.ones(2)) != key(torch.ones(2, dtype=torch.float32)) and key(
        torch.ones(2)
    ) != key(torch.ones(1, 2))
    assert key(torch.ones(100)) != key(torch.ones(100))
