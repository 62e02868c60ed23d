"""Trees: dataclasses whose tensors are declared once, where the field is.

    @dataclass(frozen=True)
    class Spring(Tree):
        node: int                       # static
        stiffness: Value = leaf(0)      # (...)
        anchor: Value = leaf(1)         # (..., 3)

A leaf has a number of axes of its own, which come last; whatever stands before them is the batch's.
It holds a tensor, plain numbers (one, a sequence, an array), None, or what stands for a tensor
until it is asked: a function or an `Input`. Fields that hold trees, alone or in a tuple, are
branches. Everything else is static. What follows from the declaration is in `leaves`.

(Trees of declared arrays: jax's pytrees; brax, `brax/base.py`.)
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import MISSING, Field, field, fields, is_dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import torch

from .declared import CHECK, Check, check_fields, declaration
from .derivatives import cached

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform

AXES = "axes"  # key of a field's metadata
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
    """Dataclass field that holds a tensor with `axes` axes of its own behind the batch axes, or a
    dictionary or named tuple of such tensors. `axes` may be a function of the object. None: the
    value has no samples (a user's function of the motion).

    Further declarations are checked when an object is created (ValueError otherwise), unless the
    field is None by default.

    - `positive`, `nonnegative`, `finite`: True: such numbers; the first two are also finite
    - `size`: int, or several: finite numbers, so many in the last axis or axes
    - `copied`: True: the object keeps a copy
    - `check`: in place of these, function(name, value), which returns the field's value, or raises
    - `name`: template of the name in messages, see `Tree.in_words`; None = the class's template

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
    """Base of dataclasses whose tensors are declared as leaves.

    Two trees are equal if they are the same object. Compare tensors by `torch.equal`, which
    compares shape and dtype too.

    Attributes:
        called: name of the class in messages; by default its own name
        in_words: template of a field's name in messages: {0} is `called`, {1} the name

    Raises:
        TypeError: when the class is defined, for a field that is annotated as a tensor and not
            declared. For a cached property that would mix values with derivatives and without
            (`cached` keeps them apart). For a `__post_init__` that skips the declared checks.

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
        names = [field.name for field in fields(self)] if is_dataclass(self) else []
        lacks = [name for name in names if name not in state and not hasattr(type(self), name)]
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
    """A static value that says whose a tree is: kept where all trees have it, see `map_leaves`."""
