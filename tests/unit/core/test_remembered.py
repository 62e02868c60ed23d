"""Remembered values: of pure functions, by all that their arguments are, and never where a
derivative is recorded.
"""

from dataclasses import dataclass

import pytest
import torch

from torchbeam.core.leaves import Tree, leaf
from torchbeam.core.remembered import LARGE, RECENT, remembered, structure_of


@dataclass(frozen=True)
class Rod(Tree):
    size: torch.Tensor = leaf(0)
    name: str = "a"


@pytest.fixture
def doubled():
    """A function that counts its calls."""

    def function(rod, *more):
        function.calls += 1
        return 2 * rod.size

    function.calls = 0
    return function


def test_what_is_the_same_to_the_bit_is_computed_once(doubled):
    """Other numbers, another static field, another dtype, or a further argument are others; a value
    of None is one too.
    """
    x = torch.tensor([1.0, 2.0])
    first = remembered(doubled, Rod(x))
    assert remembered(doubled, Rod(x.clone())) is first and doubled.calls == 1
    others = Rod(x + 1e-15), Rod(x, "b"), Rod(x.float())
    for k, other in enumerate(others, 2):
        assert torch.equal(remembered(doubled, other), 2 * other.size) and doubled.calls == k
    remembered(doubled, Rod(x), 3)
    assert doubled.calls == 5
    none = [remembered(lambda *given: doubled(*given) and None, Rod(x[0])) for _ in range(1)]
    assert none == [None]


def test_what_is_written_to_later_changes_nothing(doubled):
    """Arguments are copied: neither what is known nor a value that is a view of them follows."""
    x = torch.tensor([1.0, 2.0])
    found = remembered(lambda rod: rod.size[:1], rod := Rod(x))
    doubled_before = remembered(doubled, rod)
    x.mul_(3)
    assert found.item() == 1.0 and torch.equal(remembered(doubled, Rod(x)), 2 * x)
    assert torch.equal(remembered(doubled, Rod(x / 3)), doubled_before)


def test_arguments_in_containers_are_copied_as_well():
    """Tuples, lists and dictionaries of trees and of tensors, as a scene's bodies come."""
    for pack in (lambda x: (Rod(x), x), lambda x: [Rod(x), x], lambda x: {"a": Rod(x), "b": x}):
        x = torch.tensor([1.0, 2.0])
        part = lambda given: (given["a"] if isinstance(given, dict) else given[0]).size  # noqa: E731

        def tripled(given, part=part):
            return 3 * part(given)

        remembered(tripled, pack(x))
        x.mul_(2)
        assert torch.equal(remembered(tripled, pack(x)), 3 * x)


def test_derivatives_and_many_numbers_pass_by(doubled):
    x = torch.ones(2, requires_grad=True)
    for _ in range(2):
        remembered(doubled, Rod(x)).sum().backward()
    assert x.grad.tolist() == [4.0, 4.0] and doubled.calls == 2
    with torch.no_grad():
        remembered(doubled, Rod(x))
        remembered(doubled, Rod(x))
    assert doubled.calls == 3
    torch.func.jvp(lambda y: remembered(doubled, Rod(y)), (x.detach(),), (torch.ones(2),))
    large = Rod(torch.zeros(LARGE + 1))
    remembered(doubled, large)
    remembered(doubled, large)
    assert doubled.calls == 6


def test_the_last_few_are_kept(doubled):
    values = [torch.tensor(float(k)) for k in range(RECENT + 1)]
    for x in (*values, values[1], values[0]):
        remembered(doubled, Rod(x))
    assert doubled.calls == RECENT + 2  # the first was forgotten, the second was not


def test_structure_is_all_but_numbers():
    tensors = []
    key = structure_of([Rod(torch.ones(2)), (3, Rod(torch.zeros(())))], tensors)
    assert [x.shape for x in tensors] == [(2,), ()]
    assert key == structure_of([Rod(torch.zeros(2)), (3, Rod(torch.ones(())))], [])
    assert key != structure_of([Rod(torch.ones(2)), (4, Rod(torch.zeros(())))], [])


def test_structure_tells_one_object_from_two_alike():
    """Walks meet an object once, wherever it stands: [a, a, b] and [a, b, b] have two tensors each,
    of other places.
    """
    a, b, c = (Rod(torch.ones(2)) for _ in range(3))
    keys = [structure_of(some, []) for some in ([a, b, c], [a, a, b], [a, b, b], [a, a, a])]
    assert len(set(keys)) == 4
    assert structure_of([a, a, b], []) == structure_of([b, b, c], [])
    assert structure_of([a, 0], []) != structure_of([a, a], [])
