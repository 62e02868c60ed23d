"""Surroundings of a function: numbers, tensors and functions around it are followed; what may change unnoticed is refused."""

import functools
import math
import random
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pytest
import torch

from torchbeam.core.surroundings import Surroundings, Unsteady

number, weight, log, counted = 2.0, torch.ones(2), [], 0


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
    return Surroundings([("function", lambda: function)])


@pytest.mark.parametrize("function", [
    lambda x: math.sin(number) * torch.relu(x) + max(1.0, 2.0),
    lambda x: helper(x) @ weight,
    lambda x: frozen.gain * x + frozen.weight,
    lambda x: [y + 1 for y in x.unbind(-1)],
    functools.partial(lambda gain, x: gain * x, 3.0),
    closing((1.0, torch.ones(2))),
    torch.tanh,
])
def test_numbers_tensors_and_functions_are_steady(function):
    assert around(function).unchanged()


@pytest.mark.parametrize("function, said", [
    (lambda x: settings.gain * x, r"'settings' \(Settings\)"),
    (lambda x: log[0] * x, r"'log' \(list\)"),
    (lambda x: x + torch.as_tensor(array), r"'array' \(ndarray\)"),
    (closing({"a": 1.0}), r"'value' \(dict\)"),
    (counts, "'counted', which counts writes to"),
    (lambda x: torch.randn(2) * x, "random numbers, by 'randn'"),
    (lambda x: random.random() * x, "random numbers, by 'random'"),
    (lambda x: np.sin(1.0) * x, r"'np' \(a module\)"),
    (lambda x: print(x) or x, "'print'"),
    (lambda x: x + nowhere, "'nowhere'"),  # noqa: F821
    (Settings().__eq__, "Settings"),
    (closing(torch.ones(2).sum), r"'value' \(builtin_function_or_method\)"),
])
def test_what_may_change_unnoticed_is_refused_by_name(function, said):
    with pytest.raises(Unsteady, match=said):
        around(function)


def test_changes_are_noticed_and_equal_surroundings_have_equal_keys(monkeypatch):
    """A number that another, equal one replaces has not changed; functions made anew by the same code are the same."""
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
    """Two functions of the same code may have other defaults; a third may be the one or the other of them."""
    one, again, other = (around(lambda x, gain=gain, *, more=more: gain * more * x).key
                         for gain, more in ((1.0, 1.0), (1.0, 1.0), (1.0, 2.0)))
    assert one == again != other

    def chosen(first, second, third):
        return lambda x: first(x) + second(x) * third(x)

    a, b = closing(1.0), closing(2.0)
    assert around(chosen(a, b, a)).key == around(chosen(a, b, a)).key != around(chosen(a, b, b)).key


def test_keys_are_of_what_tuples_dataclasses_and_small_tensors_hold():
    """Made anew with the same numbers they are the same; with others, or otherwise put together, they are not."""
    def key(value):
        kept.append(around(closing(value)))
        return kept[-1].key

    kept = []
    for make in (lambda x: (x, torch.ones(2)), lambda x: Frozen(x, torch.ones(2)), lambda x: torch.tensor([x, 1.0])):
        assert key(make(float("1.5"))) == key(make(float("1.5"))) != key(make(2.0))
    assert len({key(value) for value in (((1.0, 2.0),), ((1.0,), 2.0), (1.0, 2.0), (1.0, (2.0,)))}) == 4
    assert key(torch.ones(2)) != key(torch.ones(2, dtype=torch.float32)) and key(torch.ones(2)) != key(torch.ones(1, 2))
    assert key(torch.ones(100)) != key(torch.ones(100))
