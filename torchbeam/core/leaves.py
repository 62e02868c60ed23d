"""Leaves: the tensors of a tree of dataclasses, declared once, where the field is.

    @dataclass(frozen=True)
    class Spring(Tree):
        node: int                       # static
        stiffness: Value = leaf(0)      # (...)
        anchor: Value = leaf(1)         # (..., 3)

A leaf has a number of axes of its own, which come last; whatever stands before them is the batch's.
It holds a tensor, plain numbers (one, a sequence, an array), None, or what stands for a tensor
until it is asked: a function or an `Input`. Fields that hold trees, alone or in a tuple, are
branches. Everything else is static. From the declaration follow the batch shape, dtype and device,
inputs, whether a gradient is wanted, samples taken from a batch and put back, detach and `to`.

(Trees of declared arrays: jax's pytrees; brax, `brax/base.py`.)
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import MISSING, Field, field, fields, is_dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
import torch
from torch import Tensor

from .declared import CHECK, Check, check_fields, declaration
from .derivatives import cache_of, cached, caches_of
from .validation import as_tensor, shown

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform

AXES = "axes"  # key of a field's metadata
STATIC = frozenset({type(None), bool, int, float, str})  # what holds no tree
# in an annotation: the field can hold a tensor
TENSOR = re.compile(r"\b(Tensor|Value|Motion|LoadValue|Inputs)\b")
FUNCTION = re.compile(r"\b(Callable|ClassVar)\[.*\]")  # what a function takes and gives is not held

Axes = int | Callable[[Any], int] | None


def leaf(
    axes: Axes,
    *,
    default: Any = MISSING,
    init: bool = True,
    kw_only: Any = MISSING,
    check: Check | None = None,
    name: str | None = None,
    **numbers: Any,
) -> Any:
    """A dataclass field that holds a tensor with `axes` axes of its own behind the batch's, or a
    dictionary or named tuple of such. `axes` may be a function of the object, that counts them.
    None: what the field holds cannot be taken apart by samples (a function of the motion, that a
    user wrote).

    What is declared besides is checked when an object is made (ValueError otherwise), unless the
    field is None and that is its default:

    positive, nonnegative, finite  True: such numbers; the first two are finite, too
    size    int, or several: numbers, finite, in the last axis or axes
    copied  True: the object keeps a copy of them
    check   in place of these: function(name, value), which returns what the field holds, or raises
    name    what sentences call the value, of the class's name and the field's; None = as `in_words`

    Examples:
        >>> @dataclass(frozen=True)
        ... class Anchor(extend.Tree):
        ...     place: extend.Value = extend.leaf(1, size=3)
        >>> extend.leaves(Anchor(torch.zeros(5, 3)))[0].batch_shape
        torch.Size([5])
        >>> Anchor((0.0, 1.0))
        Traceback (most recent call last):
        ValueError: Anchor's place of shape (2,) was given; (..., 3) is wanted
    """
    metadata = {AXES: axes, **declaration(check, name, **numbers)}
    return field(default=default, init=init, kw_only=kw_only, metadata=metadata)


def option(
    check: Check, *, default: Any = MISSING, kw_only: Any = MISSING, name: str | None = None
) -> Any:
    """A dataclass field that holds no tensor, checked likewise."""
    return field(default=default, kw_only=kw_only, metadata=declaration(check, name))


def branch() -> Any:
    """A dataclass field that must be given, annotated as `Sorted`: a type checker takes what has no
    value in the class for an attribute like any other.
    """
    return field()


Accepted = TypeVar("Accepted", contravariant=True)
Held = TypeVar("Held", covariant=True)


class Sorted(Generic[Accepted, Held]):
    """In an annotation: the field accepts the one when the object is made, and holds the other."""

    def __get__(self, tree: Any, owner: Any = None) -> Held:
        raise NotImplementedError

    def __set__(self, tree: Any, value: Accepted) -> None:
        raise NotImplementedError


if not TYPE_CHECKING:

    def dataclass_transform(**_: Any) -> Callable[[type], type]:
        """For type checkers alone, see PEP 681: what `leaf` declares is a field of a dataclass."""
        return lambda cls: cls


@dataclass_transform(frozen_default=True, field_specifiers=(leaf, option, branch, field))
class Tree:
    """A dataclass whose tensors are declared as leaves. Raises TypeError, when the class is
    defined, for a field that is annotated as a tensor and not declared, for a cached property
    that would mix up what is computed with derivatives and without (`cached` keeps them apart),
    and for a `__post_init__` that leaves out the checks that fields declare.

    Two trees are equal where they are one object: whether tensors are alike is for torch to say
    (`torch.equal`, of shape and dtype as well).

    Attributes:
        called: what sentences call the class: its name, unless it says another
        in_words: what they call a field, of that and the field's name

    Examples:
        >>> @dataclass(frozen=True)
        ... class Spring(extend.Tree):
        ...     node: int
        ...     stiffness: extend.Value = extend.leaf(0)
        >>> [leaf.name for leaf in extend.leaves(Spring(3, torch.tensor(2.0)))]
        ['stiffness']
    """

    called: ClassVar[str]
    in_words: ClassVar[str] = "{}'s {}"

    def __post_init__(self) -> None:
        """Checks the fields; a class that checks them together as well calls this first."""
        check_fields(self)

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles go without what is this object's alone: ` name`."""
        return {name: value for name, value in vars(self).items() if not name.startswith(" ")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """ValueError for what another version has saved, whose class had other fields."""
        own = [field.name for field in fields(self)] if is_dataclass(self) else []
        lacks = [name for name in own if name not in state and not hasattr(type(self), name)]
        if lacks:
            raise ValueError(
                f"a {type(self).__name__} that another version of torchbeam saved was given, "
                f"without {', '.join(lacks)}; one of this version is wanted"
            )
        vars(self).update(state)

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        if cls.__module__.startswith("torchbeam."):
            # fields alone: torch.load(weights_only=True) takes them
            torch.serialization.add_safe_globals([cls])
        cls.called = vars(cls).get("called", cls.__name__)
        if "__eq__" not in vars(cls):  # else a dataclass compares tensors, whose answer is a tensor
            cls.__eq__, cls.__hash__ = object.__eq__, object.__hash__
        for name, value in vars(cls).items():
            if isinstance(value, cached_property) and not isinstance(value, cached):
                raise TypeError(
                    f"{cls.__name__}.{name} is a functools.cached_property; "
                    "torchbeam.core.derivatives.cached is wanted, which keeps values with "
                    "derivatives and without apart"
                )
        made = getattr(vars(cls).get("__post_init__"), "__code__", None)
        if made is not None and "__post_init__" not in made.co_names:
            for name, value in vars(cls).items():
                if isinstance(value, Field) and CHECK in value.metadata:
                    raise TypeError(
                        f"{cls.__name__}.{name} declares a check that {cls.__name__}.__post_init__ "
                        "leaves out; super().__post_init__() is wanted in it"
                    )
        for name, kind in vars(cls).get("__annotations__", {}).items():
            declared = vars(cls).get(name)
            if TENSOR.search(FUNCTION.sub("", str(kind))) and not (
                isinstance(declared, Field) and AXES in declared.metadata
            ):
                raise TypeError(
                    f"{cls.__name__}.{name} can hold a tensor; {name}: {kind} = leaf(axes) is "
                    "wanted, with its number of axes behind the batch's"
                )


class FunctionOfTime(Tree):
    """A tree that is a function of t: it may be a leaf, and declares the tensors that it holds."""


class Placeholder:
    """Stands for a tensor that is given later."""


class Mark:
    """A static value that says whose a tree is: of several trees it stays where all have the same
    object, see `map_leaves`.
    """


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
    """The leaves that a tree declares itself, None among them; a tree in the place of a leaf as it
    is.

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
    """All leaves of a tree, of trees in tuples, lists and dictionaries, but for None; what stands
    in two places comes twice.

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
    not None; trees in tuples, lists and dictionaries likewise. Objects are copied without checking
    them again and without what they had cached, and not at all where nothing in them changes; one
    that stands in several places is made once. Static fields are the first tree's; of a `Mark` that
    others do not share None is left.

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
    """A copy of a tree with these values of fields, which are not checked again, and nothing that
    it had cached. What its field `follows` names has been found, and may be again; what is given
    here has not.

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
