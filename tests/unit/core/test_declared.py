"""What a field's value must be is declared where the field is; checks and sentences follow."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch

from torchbeam.core.arguments import boolean, count
from torchbeam.core.declared import one_of, optional, parameter, together
from torchbeam.core.leaves import Tree, leaf, option

Value = Any


@dataclass(frozen=True)
class Wheel(Tree):
    radius: Value = leaf(0, positive=True, copied=True)
    friction: Value | None = leaf(0, default=None, nonnegative=True)
    speed: Value | None = leaf(0, default=None, finite=True, name="the speed of a {}")
    axis: Value = leaf(1, default=(1.0, 0.0, 0.0), size=3)
    inertia: Value | None = leaf(2, default=None, size=(3, 3))
    play: Value | None = leaf(0, default=None, check=optional)
    spokes: int = option(count, default=8)
    solid: bool = option(boolean, default=False)
    free: Value = leaf(0, default=None)  # declares nothing, holds anything


@dataclass(frozen=True)
class Pulley(Wheel):
    in_words = "a {}'s {}"

    def __post_init__(self):
        super().__post_init__()
        together(self, ("friction", "speed"))
        one_of(self, "play", "inertia")


REFUSED = {
    "Wheel's radius = 0 was given; a positive finite number is wanted": dict(radius=0.0),
    "Wheel's radius = inf was given; a positive finite number is wanted": dict(radius=np.inf),
    "None was given; numbers or a tensor are wanted": dict(radius=None),
    "Wheel's friction = -1 was given; a non-negative finite number is wanted": dict(
        friction=torch.tensor([1.0, -1.0])
    ),
    "the speed of a Wheel holds nan; finite numbers are wanted": dict(speed=np.nan),
    r"Wheel's axis of shape \(2,\) was given; \(..., 3\) is wanted": dict(axis=(1.0, 0.0)),
    "Wheel's axis holds inf; finite numbers are wanted": dict(axis=(1.0, 0.0, np.inf)),
    r"Wheel's inertia of shape \(3,\) was given; \(..., 3, 3\) is wanted": dict(
        inertia=(1.0, 2.0, 3.0)
    ),
    r"Wheel's spokes = 0 was given; a whole number of at least 1 is wanted": dict(spokes=0),
    "Wheel's solid = 1 was given; True or False is wanted": dict(solid=1),
    "'round' was given; numbers or a tensor are wanted": dict(friction="round"),
}


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_is_declared_is_checked(sentence):
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        Wheel(**{"radius": 1.0, **REFUSED[sentence]})


def test_what_a_field_holds():
    radius, axis = torch.ones(2), torch.ones(4, 3, dtype=torch.float64)
    wheel = Wheel(radius, axis=axis, play=0, free="anything")
    assert wheel.axis is axis and wheel.radius.dtype == torch.float64
    radius += 1
    assert (wheel.radius == 1).all()  # its own
    assert wheel.play is None and wheel.friction is None and wheel.free == "anything"
    assert isinstance(Wheel(1, friction=2).friction, np.ndarray)  # plain numbers have no dtype yet
    again = replace(wheel, spokes=3)
    assert again.axis is axis and torch.equal(again.radius, wheel.radius)


def test_several_fields_are_checked_after_each_of_them():
    assert Pulley(1.0, play=0.1).play == 0.1
    for given, sentence in [
        (dict(radius=-1.0), "a Pulley's radius = -1 was given"),
        (dict(friction=0.1), "a Pulley with friction alone was given; friction and speed"),
        ({}, "Pulley with neither play nor inertia was given; one of them is wanted"),
    ]:
        with pytest.raises(ValueError, match=f"^{sentence}"):
            Pulley(**{"radius": 1.0, **given})


def test_a_check_cannot_be_left_out():
    def made(self):
        pass

    names = {"__annotations__": {"x": "Value"}, "x": leaf(0, positive=True)}
    with pytest.raises(TypeError, match=r"Bad\.x declares a check that .* leaves out; super"):
        type("Bad", (Tree,), {**names, "__post_init__": made})
    type("Good", (Tree,), {**names, "x": leaf(0), "__post_init__": made})
    with pytest.raises(TypeError, match="a check and what numbers must be were declared"):
        leaf(0, check=optional, positive=True)


def test_a_class_may_check_by_itself():
    @dataclass(frozen=True)
    class Brake(Tree):
        c: Value = leaf(0)

        def __post_init__(self):
            object.__setattr__(self, "c", parameter("Brake's c", self.c))

    assert Brake(1.0).c == 1
    with pytest.raises(ValueError, match="Brake's c = -1 was given"):
        Brake(-1.0)
