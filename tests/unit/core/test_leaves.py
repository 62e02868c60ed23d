"""Leaves: tensors are declared once, and everything that handles them as a whole follows from
that.
"""

import functools
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pytest
import torch

import torchbeam as tb
from torchbeam.core.batch_subset import BatchSubset, NotSeparable
from torchbeam.core.derivatives import cached, no_derivatives
from torchbeam.core.leaves import (
    Tree,
    batch_shapes,
    detached,
    functions,
    leaf,
    leaves,
    map_leaves,
    values,
    wants_gradient,
)

Value = Any


@dataclass(frozen=True)
class Point(Tree):
    name: str
    place: Value = leaf(1)
    weight: Value = leaf(0, default=1.0)
    after: torch.Tensor | None = leaf(lambda self: 2 if self.name == "matrix" else 1, default=None)


@dataclass(frozen=True)
class Cloud(Tree):
    points: tuple[Point, ...]
    centre: Point | None = None
    inputs: dict[str, torch.Tensor] = leaf(1, default=None)
    law: Value = leaf(None, default=None)

    @cached
    def total(self):
        return sum(p.weight for p in self.points)


def point(**more):
    return Point("p", torch.arange(12.0).reshape(4, 3), torch.arange(4.0), **more)


def test_values_are_those_of_leaves_each_object_once():
    """A tree in a leaf's place, or in its dictionary, is gone into; a point in two places, whose
    leaves come twice, counts once.
    """
    shared, inner = point(), Point("q", torch.ones(3), torch.ones((), requires_grad=True))
    cloud = Cloud((shared, shared), point(), inputs={"u": torch.ones(2), "of": inner}, law=inner)
    once = [id(x) for x in values(cloud)]
    every = [id(leaf.value) for leaf in leaves(cloud) if leaf.value is not inner]
    assert {*once} == {*every} | {id(inner.place), id(inner.weight)}
    assert once.count(id(shared.place)) == 1 and every.count(id(shared.place)) == 2
    for tree in (Cloud((), inputs={"of": inner}), Cloud((), law=inner), [{"a": (inner,)}]):
        assert wants_gradient(tree) and not wants_gradient(detached(inner))


def test_every_leaf_is_found_once_with_its_axes():
    cloud = Cloud(
        (point(), Point("matrix", np.ones(3), 2.0, torch.ones(5, 1, 2, 2))),
        inputs={"u": torch.ones(4, 2)},
    )
    found = [(one.name, one.axes, one.batch_shape) for one in leaves(cloud)]
    assert found == [
        ("inputs", 1, (4,)), ("place", 1, (4,)), ("weight", 0, (4,)), ("place", 1, ()),
        ("weight", 0, None), ("after", 2, (5, 1)),
    ]  # fmt: skip
    assert torch.broadcast_shapes(*batch_shapes(cloud)) == (5, 4)


def test_a_tensor_that_is_not_declared_is_an_error_where_the_class_is_defined():
    for kind in ("torch.Tensor", "Tensor | None", "Value", "dict[str, Tensor]"):
        with pytest.raises(TypeError, match=r"Bad\.x can hold a tensor.*leaf\(axes\)"):
            type("Bad", (Tree,), {"__annotations__": {"x": kind}})
    type("Good", (Tree,), {"__annotations__": {"f": "Callable[[Tensor], Tensor]", "n": "int"}})


def test_a_mapped_tree_is_a_copy_without_caches_and_shares_what_was_shared():
    one = point()
    cloud = Cloud((one, one), one)
    assert cloud.total.shape == (4,)
    doubled = map_leaves(lambda value, axes: 2 * value, cloud)
    assert doubled.points[0] is doubled.points[1] is doubled.centre and not any(
        "total" in name for name in vars(doubled)
    )
    assert torch.equal(doubled.total, 2 * cloud.total) and torch.equal(
        one.weight, torch.arange(4.0)
    )


def test_gradient_is_seen_wherever_it_is_held():
    w = torch.ones(4, requires_grad=True)
    cloud = Cloud((point(),), Point("p", torch.zeros(3), w))
    assert (
        wants_gradient(cloud)
        and not wants_gradient(detached(cloud))
        and not wants_gradient(Cloud((point(),)))
    )
    with torch.no_grad():
        assert not wants_gradient(cloud)
    torch.func.jvp(
        lambda x: (_ for _ in ()).throw(AssertionError) if not wants_gradient(Point("p", x)) else x,
        (torch.ones(3),),
        (torch.ones(3),),
    )


def test_what_is_cached_without_derivatives_is_not_what_is_cached_with_them():
    w = torch.ones(4, requires_grad=True)
    cloud = Cloud((Point("p", torch.zeros(3), w),))
    with no_derivatives():
        assert not cloud.total.requires_grad
    assert cloud.total.requires_grad and cloud.total is cloud.total
    with torch.no_grad():  # what has them serves without
        assert (2 * cloud.total).requires_grad is False
    with pytest.raises(
        TypeError, match=r"Bad\.x is a functools\.cached_property.*cached is wanted"
    ):
        type("Bad", (Tree,), {"x": functools.cached_property(lambda self: 0)})


def test_samples_are_taken_and_put_back():
    """Where there is a batch axis: functions by their values, plain numbers as arrays, what is
    everybody's left alone.
    """
    few = BatchSubset(torch.tensor([1, 3]), 4)
    cloud = Cloud(
        (point(), Point("p", lambda t: t * torch.ones(4, 3), np.arange(4.0))),
        Point("p", torch.zeros(3)),
    )
    part = few.gather(cloud)
    assert torch.equal(part.points[0].place, cloud.points[0].place[[1, 3]])
    assert part.points[1].place(torch.tensor(2.0)).shape == (2, 3) and part.points[
        1
    ].weight.tolist() == [1, 3]
    assert part.centre.place.shape == (3,) and [f.name for f in functions(part)] == ["place"]
    back = few.scatter(
        Cloud((point(),)), Cloud((map_leaves(lambda v, axes: -few.take(v, axes), point()),))
    )
    assert back.points[0].weight.tolist() == [0, -1, 2, -3]
    with pytest.raises(NotSeparable):
        few.gather(Cloud((), law=lambda position: position))


def test_merging_goes_by_declared_axes_and_not_by_shapes():
    """A batch of 3 beside axes of size 3: what has no batch axis stays as it was, whatever its
    sizes; one sample may bring a batch axis of size 1; one value for all becomes one for each where
    a sample has its own. Out of place, with gradients.
    """
    one = BatchSubset(torch.tensor([1]), 3)
    shared, own = torch.zeros(3, requires_grad=True), torch.arange(3.0, requires_grad=True)
    cloud = Cloud((Point("p", shared, own), Point("p", torch.zeros(1, 3), torch.tensor(0.0))))
    single = torch.tensor([7.0], requires_grad=True)
    part = Cloud(
        (Point("p", torch.ones(3), single), Point("p", torch.ones(1, 3), torch.tensor([5.0])))
    )
    merged = one.merge(cloud, part)
    assert merged.points[0].place is shared and merged.points[0].weight.tolist() == [0, 7, 2]
    assert torch.equal(merged.points[1].place, torch.tensor([0.0, 1, 0])[:, None].expand(3, 3))
    assert merged.points[1].weight.tolist() == [0, 5, 0] and own.tolist() == [0, 1, 2]
    by = torch.autograd.grad(
        (merged.points[0].weight * torch.tensor([1.0, 2, 4])).sum(), (own, single)
    )
    assert [g.tolist() for g in by] == [[1, 0, 4], [2]]


def test_a_function_is_merged_where_it_holds_the_same():
    one = BatchSubset(torch.tensor([1]), 3)

    def cloud(rate, values):
        return Cloud((), law=lambda t: rate * values * t)

    def named(rate):
        return Cloud((), law=lambda t, *, rate=rate: rate * t)

    def recursive(rate):
        def law(t):
            return rate * t if t < 1 else law(t / 2)

        return Cloud((), law=law)

    whole = cloud(2.0, torch.ones(3))
    assert one.merge(whole, cloud(2.0, torch.ones(3))) is whole
    pairs = [
        (whole, part)
        for part in (cloud(2.0, torch.ones(1)), cloud(3.0, torch.ones(3)), Cloud((), law=torch.sin))
    ]
    for kind in (named, recursive):
        pairs.append((kind(1.0), kind(2.0)))
        assert one.merge(kind(1.0), kind(1.0)).law(0.5) == 0.5
    for whole, part in pairs:
        with pytest.raises(ValueError, match="a function that holds other things"):
            one.merge(whole, part)


def test_a_tree_is_equal_to_itself_alone():
    """Comparing tensors gives tensors, which `==` of a tuple, `in` and a dictionary cannot take for
    an answer.
    """
    one, other = (Cloud((point(),), point()) for _ in range(2))
    assert one == one and one != other and other not in (one,) and len({one: 0, other: 1}) == 2
    assert hash(one) == hash(one) and map_leaves(lambda value, axes: value, one) == one


def test_what_another_version_saved_is_refused_in_a_sentence():
    """A field that its class had not yet, of an object by itself and of one within a file."""
    section = tb.Section.from_stiffness(EA=1.0, GA=1.0, GJ=1.0, EI=1.0, mass=1.0)
    beam = tb.Beam.straight(1.0, 2, section)
    held = beam.__getstate__()
    name = next(field.name for field in fields(beam) if not hasattr(tb.Beam, field.name))
    del held[name]
    with pytest.raises(ValueError, match=f"^a Beam that another version .* without {name}; one"):
        object.__new__(tb.Beam).__setstate__(held)
