"""A new effect is one class: batches, compaction, gradients, planes, save and load follow from its
declaration. This one is written here, and no list anywhere knows it.
"""

import copy
import io
import pickle
from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.extend import (
    POSITION,
    VELOCITY,
    BatchSubset,
    LoadEffect,
    Value,
    detached,
    leaf,
    leaves,
    map_leaves,
)

SOFT = dict(EA=4e3, GA=2e3, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
B = 6


@dataclass(frozen=True)
class Magnet(LoadEffect):
    """A node drawn to a point by a force that falls off with distance, s d/(a^2 + |d|^2)^2, with
    some friction; its tangent comes by automatic differentiation.
    """

    strength: Value = leaf(0)  # N m^3
    at: Value = leaf(1)  # (..., 3) m
    width: Value = leaf(0, default=0.5)  # m
    friction: Value = leaf(0, default=0.1)  # N s/m
    node: int = -1

    depends = frozenset({POSITION, VELOCITY})

    def wrench(self, point, t, inputs):
        d = self.at - point.position
        size = self.width[..., None] ** 2 + d.square().sum(-1, keepdim=True)
        return self.strength[..., None] * d / size**2 - self.friction[
            ..., None
        ] * point.velocity, None


def number(*shape):
    return torch.linspace(0.5, 1.5, B * int(torch.tensor(shape).prod())).reshape(B, *shape)


def magnet(B=B, at=(0.8, 0.0, 0.4), **more):
    """Of several strengths, one of them so strong that Newton's method takes longest."""
    strength = torch.linspace(0.01, 0.02, B)
    strength[-1] = 3.0
    return Magnet(**{"strength": strength, "at": at, **more})


def scene(effect, **options):
    return tb.Scene(
        tb.Beam.straight(1.0, 2, tb.Section.from_stiffness(**SOFT)), [effect], **options
    )


def tip(effect, steps=3, engine="auto", **options):
    stepper = tb.Stepper(scene(effect, **options), 0.05, tolerance=1e-12, engine=engine)
    state = stepper.rest()
    for _ in range(steps):
        state = stepper(state)
    assert (state.status == 0).all()
    return state.position[..., -1, :]


def test_numbers_become_the_beams_and_axes_the_batchs():
    made = scene(Magnet(number(), number(3), width=0.4))
    assert made.batch_shape == (B,) and all(
        one.value.dtype == made.dtype for one in leaves(made.effects[0])
    )
    assert isinstance(made.effects[0].width, Tensor)
    single = scene(Magnet(number().float(), (1.0, 0, 0)))
    assert all(one.value.dtype == made.dtype for one in leaves(single.effects[0]))
    with pytest.raises(ValueError):
        scene(Magnet(number(), torch.zeros(B + 1, 3)))


def test_a_sample_in_a_batch_is_the_sample_alone(monkeypatch):
    """Steps of a batch so large that it is taken apart as its samples converge, and of some of its
    samples.
    """
    many, gathered, gather = 80, [], BatchSubset.gather
    effect = magnet(many, at=(0.8, 0.1, 0.4))
    monkeypatch.setattr(
        BatchSubset, "gather", lambda few, tree: gathered.append(few) or gather(few, tree)
    )
    together = tip(effect, engine="eager")
    assert gathered
    assert_close(tip(effect), together, rtol=0, atol=1e-11)
    for k in (0, many // 2, many - 1):
        assert_close(
            together[k], tip(replace(effect, strength=effect.strength[k])), rtol=0, atol=1e-11
        )


def test_gradients_by_its_tensors():
    """Backward and forward against central differences, whose truncation and rounding are below
    1e-7 of values of size one.
    """
    effect = scene(magnet()).effects[0]
    names = [one.name for one in leaves(effect)]
    assert names == ["strength", "at", "width", "friction"]
    for name in names:
        x = getattr(effect, name)

        def f(x, name=name):
            return tip(replace(effect, **{name: x})).sum()

        way, h = torch.ones_like(x), 1e-5
        differences = (f(x + h * way) - f(x - h * way)) / (2 * h)
        y = x.clone().requires_grad_()
        (slope,) = torch.autograd.grad(f(y), y)
        assert differences.abs() > 1e-5
        assert_close((slope * way).sum(), differences, rtol=1e-5, atol=1e-8)
        assert_close(torch.func.jvp(f, (x,), (way,))[1], differences, rtol=1e-5, atol=1e-8)


def test_in_a_plane_it_is_what_it_is_in_space():
    """A pull in the plane; out of it, it is refused."""
    assert_close(tip(magnet(), plane="xz"), tip(magnet()), rtol=0, atol=1e-10)
    assert tb.Stepper(scene(magnet(), plane="auto"), 0.05).model.space.unknowns == 3
    with pytest.raises(ValueError, match="Magnet out of the plane 'xz'"):
        tb.Stepper(scene(magnet(at=(0.8, 0.3, 0.4)), plane="xz"), 0.05)


def test_saved_and_loaded_it_acts_alike():
    made = scene(magnet())
    file = io.BytesIO()
    torch.save(made, file)
    file.seek(0)
    want = tip(magnet())
    for again in (
        torch.load(file, weights_only=False),
        pickle.loads(pickle.dumps(made)),
        copy.deepcopy(made),
    ):
        assert type(again.effects[0]) is Magnet
        assert_close(tip(again.effects[0]), want, rtol=0, atol=0)


def test_it_is_detached_and_mapped_as_a_whole():
    effect = magnet(strength=number().requires_grad_())
    made = scene(effect)
    assert made.effects[0].strength.requires_grad
    assert not any(
        one.value.requires_grad for one in leaves(detached(made)) if isinstance(one.value, Tensor)
    )
    single = map_leaves(
        lambda value, axes: value.float() if isinstance(value, Tensor) else value, made
    )
    assert single.effects[0].at.dtype == single.beam.nodes.dtype == torch.float32
    assert single.effects[0].node == -1


def test_a_tensor_that_it_does_not_declare_is_refused_where_the_class_is_written():
    with pytest.raises(TypeError, match=r"Forgetful\.strength can hold a tensor.*leaf\(axes\)"):

        @dataclass(frozen=True)
        class Forgetful(LoadEffect):
            strength: Tensor


@dataclass(frozen=True)
class Tie(LoadEffect):
    """A spring to a point without a length of its own, as `Spring` is one; it answers what is asked
    of a stiffness.
    """

    stiffness: Value = leaf(0)
    anchor: Value = leaf(1)
    node: int = -1

    depends = frozenset({POSITION})
    conservative = True

    def wrench(self, point, t, inputs):
        return self.stiffness[..., None] * (self.anchor - point.position), None

    def in_free_vibration(self):
        return self


def test_what_is_asked_of_a_stiffness_it_answers_itself():
    """Frequencies with it are those with a `Spring`, it holds a free beam, and its point may not
    leave the plane.
    """
    for options in (dict(), dict(supports=())):
        both = (Tie(3.0, (1.0, 0, 0)), tb.Spring(-1, 3.0, (1.0, 0, 0)))
        lines = [tb.describe(scene(e, **options)).lines["frequencies"] for e in both]
        without = tb.describe(scene(tb.Gravity((0.0, 0, 0)), **options)).lines["frequencies"]
        assert lines[0] == lines[1] != without
    # slack: no wrench
    for made, name in (
        (Tie(0.0, (1.0, 0.1, 0)), "Tie"),
        (tb.Spring(-1, 0.0, (1.0, 0.1, 0)), "Spring"),
    ):
        with pytest.raises(ValueError, match=f"a {name} to a point out of the plane 'xz'"):
            tb.Stepper(scene(made, plane="xz"), 0.05)


def test_an_effect_acts_along_the_beam_unless_it_says_at_which_node():
    assert tb.Damping(0.1).node is None and tb.Gravity((0.0, 0, 0)).node is None
    assert tb.PointLoad(2, force=(0.0, 0, 1)).node == 2
    with pytest.raises(ValueError, match="which is not an effect"):
        scene(type("Alien", (), {"kind": "load"})())
    with pytest.raises(TypeError, match=r"Unsaid\.node is a field without a value"):

        @dataclass(frozen=True)
        class Unsaid(LoadEffect):
            node: int
