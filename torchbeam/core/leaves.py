"""Leaves of trees (see `tree`), and what follows from their declaration: the batch shape, dtype and
device, inputs, whether a gradient is wanted, samples taken from a batch and put back, detach and
`to`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from .derivatives import cache_of, caches_of
from .tree import AXES, FunctionOfTime, Mark, Placeholder, Tree
from .tree import Sorted as Sorted
from .tree import branch as branch
from .tree import leaf as leaf
from .tree import option as option
from .validation import as_tensor, shown

STATIC = frozenset({type(None), bool, int, float, str})  # what holds no tree


class Leaf(NamedTuple):
    """One leaf: who holds it, its name there, its value, its own axes (None: not separable)."""

    owner: Any
    name: str
    value: Any
    axes: int | None

    @property
    def batch_shape(self) -> torch.Size | None:
        """Its leading axes; None where it is not a tensor (or an array)."""
        if not isinstance(self.value, (Tensor, np.ndarray)) or self.axes is None:
            return None
        return torch.Size(self.value.shape[: max(self.value.ndim - self.axes, 0)])


def own_leaves(tree: Tree) -> list[Leaf]:
    """Leaves that a tree declares itself, also None; a tree in place of a leaf is not opened.

    Examples:
        >>> [leaf.name for leaf in extend.own_leaves(tb.TipLoad(force=torch.ones(3)))]
        ['moment', 'force', 'offset']
    """
    declared, found = _declared(type(tree)), []
    for name, value in [*vars(tree).items()]:
        if (axes := declared.get(name, BRANCH)) is not BRANCH:
            axes = axes(tree) if callable(axes) else axes
            found += [Leaf(tree, name, part, axes) for part in _parts(value)]
    return found


def _parts(value: Any) -> Iterable[Any]:
    """What a leaf's field holds: a dictionary or named tuple of values, or one."""
    if value is None or isinstance(value, Tensor):
        return (value,)
    if isinstance(value, dict):
        return value.values()
    return value if hasattr(value, "_fields") else (value,)


def leaves(tree: Any) -> list[Leaf]:
    """All leaves of a tree that are not None, also of trees in tuples, lists and dictionaries. A
    leaf in two places comes twice.

    Examples:
        >>> [leaf.name for leaf in extend.leaves(tb.TipLoad(force=torch.ones(3)))]
        ['force']
    """
    found: list[Leaf] = []
    _add_leaves(tree, found)
    return found


def _add_leaves(tree: Any, found: list[Leaf]) -> None:
    if isinstance(tree, Tree):
        for leaf in own_leaves(tree):
            if isinstance(leaf.value, Tree):
                _add_leaves(leaf.value, found)
            elif leaf.value is not None:
                found.append(leaf)
        declared = _declared(type(tree))
        for name, value in [*vars(tree).items()]:
            if type(value) not in STATIC and declared.get(name) is BRANCH:
                _add_leaves(value, found)
    elif isinstance(tree, (tuple, list, dict)):
        for part in tree.values() if isinstance(tree, dict) else tree:
            _add_leaves(part, found)


def values(tree: Any) -> list[Any]:
    """Those of `leaves`, of an object in several places once."""
    found: list[Any] = []
    for value, _ in leaves_in_order(tree):
        if isinstance(value, Tree):  # in a leaf's dictionary
            found += values(value)
        elif value is not None:
            found.append(value)
    return found


def leaves_in_order(tree: Any) -> list[tuple[Any, int | None]]:
    """Values and own axes of all leaves that `map_leaves` meets, in order, each object once."""
    found: list[tuple[Any, int | None]] = []
    _add_in_order(tree, found, set())
    return found


def _add_in_order(tree: Any, found: list[tuple[Any, int | None]], seen: set[int]) -> None:
    if isinstance(tree, Tree):
        if id(tree) in seen:
            return
        seen.add(id(tree))
        declared = _declared(type(tree))
        for name, value in [*vars(tree).items()]:
            if value is None or name not in declared:
                continue
            if (axes := declared[name]) is BRANCH or isinstance(value, Tree):
                if type(value) not in STATIC:
                    _add_in_order(value, found, seen)
                continue
            axes = axes if type(axes) is int or axes is None else axes(tree)
            if isinstance(value, Tensor):
                found.append((value, axes))
            else:
                found += [(part, axes) for part in _parts(value)]
    elif isinstance(tree, (tuple, list, dict)):
        for part in tree.values() if isinstance(tree, dict) else tree:
            if type(part) not in STATIC:
                _add_in_order(part, found, seen)


def map_leaves(
    function: Callable[..., Any], tree: Any, *others: Any, results: dict[int, Any] | None = None
) -> Any:
    """The tree with `function(value, axes, *values of the others)` in place of each leaf that is
    not None, also in tuples, lists and dictionaries. Objects are copied without checks and without
    cached values; an unchanged object is not copied. An object in several places is copied once.
    Static fields come from the first tree. A `Mark` that the others do not share becomes None.

    Examples:
        >>> load = tb.TipLoad(force=torch.ones(3))
        >>> extend.map_leaves(lambda value, axes: 2 * value, load).force
        tensor([2., 2., 2.])
    """
    results = {} if results is None else results
    if isinstance(tree, Mark):
        return tree if all(other is tree for other in others) else None
    if isinstance(tree, Tree):
        if id(tree) not in results:
            # held, so that its id stays its own
            results[id(tree)] = tree, _mapped(function, tree, others, results)
        return results[id(tree)][1]
    if isinstance(tree, (tuple, list)):
        parts = [
            map_leaves(function, part, *(o[i] for o in others), results=results)
            for i, part in enumerate(tree)
        ]
        if all(a is b for a, b in zip(parts, tree, strict=True)):
            return tree
        new = type(tree)(*parts) if hasattr(tree, "_fields") else type(tree)(parts)
        if hasattr(tree, "__dict__"):
            vars(new).update(vars(tree))
        return new
    if isinstance(tree, dict):
        return {
            name: map_leaves(function, part, *(o[name] for o in others), results=results)
            for name, part in tree.items()
        }
    return tree


def _mapped(
    function: Callable[..., Any], tree: Tree, others: tuple, results: dict[int, Any]
) -> Any:
    mapped, same, declared = {}, True, _declared(type(tree))
    for name, value in [*vars(tree).items()]:
        if name not in declared:
            if not cache_of(tree, name):
                mapped[name] = value
            continue
        theirs, axes = tuple(getattr(o, name) for o in others), declared[name]
        axes = axes(tree) if callable(axes) else axes
        if axes is BRANCH or isinstance(value, Tree):
            mapped[name] = map_leaves(function, value, *theirs, results=results)
        elif isinstance(value, dict):
            new = {
                key: function(part, axes, *(t[key] for t in theirs)) for key, part in value.items()
            }
            mapped[name] = new if any(new[key] is not x for key, x in value.items()) else value
        elif hasattr(value, "_fields"):
            mapped[name] = type(value)(
                *(function(part, axes, *(t[i] for t in theirs)) for i, part in enumerate(value))
            )
        else:
            mapped[name] = None if value is None else function(value, axes, *theirs)
        same = same and mapped[name] is value
    if same:
        return tree
    new = object.__new__(type(tree))
    vars(new).update(mapped)
    return new


def with_values(tree: Any, **values: Any) -> Any:
    """A copy of a tree with these values of fields, without checks and cached values. Fields that
    its field `follows` names are derived, and may be derived again; values of this call are not.

    Examples:
        >>> extend.with_values(tb.TipLoad(force=torch.ones(3)), force=torch.zeros(3)).force
        tensor([0., 0., 0.])
    """
    new, caches = object.__new__(type(tree)), caches_of(type(tree))
    held = vars(tree)
    if caches:
        held = {
            name: value for name, value in held.items() if " " not in name and name not in caches
        }
    vars(new).update(held, **values)
    if held.get("follows") and "follows" not in values:
        vars(new)["follows"] = tuple(name for name in held["follows"] if name not in values)
    return new


BRANCH = object()  # a field that is no leaf: what it holds may be trees


@cache
def _declared(kind: type) -> dict[str, Any]:
    """Fields of a class by name: a leaf's own axes, or `BRANCH`."""
    return {
        name: field.metadata.get(AXES, BRANCH)
        for name, field in getattr(kind, "__dataclass_fields__", {}).items()
    }


def batch_shapes(tree: Any) -> list[torch.Size]:
    """The batch axes of every leaf that is a tensor."""
    return [shape for shape in (leaf.batch_shape for leaf in leaves(tree)) if shape is not None]


def constant(tree: Any) -> bool:
    """Whether every leaf is a tensor or numbers: none a function, none given later."""
    if isinstance(tree, Tree):
        return not isinstance(tree, FunctionOfTime) and all(
            constant(leaf.value) for leaf in own_leaves(tree)
        )
    return isinstance(tree, Tensor) or not (callable(tree) or isinstance(tree, Placeholder))


def functions(tree: Any) -> list[Leaf]:
    """Leaves that are functions; tensors that these close over are unknown."""
    return [leaf for leaf in leaves(tree) if is_function(leaf.value)]


def is_function(value: Any) -> bool:
    return not isinstance(value, Tensor) and callable(value)


def detached(tree: Any) -> Any:
    """The tree without gradient.

    Examples:
        >>> load = tb.TipLoad(force=torch.ones(3, requires_grad=True))
        >>> extend.detached(load).force.requires_grad
        False
    """
    return map_leaves(
        lambda value, axes: value.detach() if isinstance(value, Tensor) else value, tree
    )


def sent(tree: Any, *args: Any, **kwargs: Any) -> Any:
    """The tree with all tensors on another device, or the floating ones in another dtype: arguments
    of `Tensor.to`. Raises ValueError for others.
    """
    try:
        torch.empty(0).to(*args, **kwargs)
    except (TypeError, ValueError, RuntimeError, OverflowError):
        said = ", ".join((*map(shown, args), *(f"{k} = {shown(v)}" for k, v in kwargs.items())))
        raise ValueError(
            f"{said} was given; a device or a floating dtype, as `Tensor.to` takes them, is wanted"
        ) from None

    def to(value: Any, axes: int | None) -> Any:
        if not isinstance(value, Tensor):
            return value
        moved = value.to(*args, **kwargs)
        return moved if value.is_floating_point() else moved.to(value.dtype)

    return map_leaves(to, tree)


def bound(tree: Any, dtype: torch.dtype, device: torch.device) -> Any:
    """The tree with numbers and tensors as tensors of the dtype and on the device; differentiable.
    Raises ValueError for a tensor of other than single and double precision.
    """

    def bind(value: Any, axes: int | None) -> Any:
        number = axes is not None and isinstance(value, (np.ndarray, list, tuple, int, float))
        return as_tensor(value, dtype, device) if number or isinstance(value, Tensor) else value

    return map_leaves(bind, tree)


def wants_gradient(*trees: Any) -> bool:
    """Whether a derivative, backward or forward, is recorded for one of these tensors or trees."""
    found: list[Any] = []
    for tree in trees:
        found += [tree] if isinstance(tree, Tensor) else values(tree)
    return recorded(found)


def recorded(values: list[Any]) -> bool:
    """The same of tensors among values, trees apart."""
    forward = torch.autograd.forward_ad
    backward, dual = torch.is_grad_enabled(), forward._current_level >= 0
    return any(
        (backward and x.requires_grad) or (dual and forward.unpack_dual(x).tangent is not None)
        for x in values
        if isinstance(x, Tensor)
    )
