"""Entry points: what users call. Within them torch.autocast is off, and torch.compile leaves them
alone.

Autocast would compute matrix products of float32 in half precision, in which no step converges; a
function of the user's that is called from inside, a load or a network, runs without it too.
torch.compile would trace Python that is no tensor program: native code, Newton's iterations, what
is kept from call to call. It breaks its graph here instead, and compiles what the user has around
it. Who uses neither pays under a microsecond a call.
"""

from __future__ import annotations

import functools
import inspect
import types
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import torch

from .derivatives import cached

T = TypeVar("T")
DEVICES = "cpu", "cuda"
# beside the public names of a class: what Python calls for its user
NAMES = ("init", "call", "getitem", "iter", "repr", "str", "add", "mul")
SPECIAL = {f"__{name}__" for name in NAMES}
# by which torch.compile knows what not to trace; `torch.compiler.disable` sets it too, but imports
# all of torch's compiler
MARK = "_torchdynamo_disable"
autocast = torch._C._is_any_autocast_enabled  # in a third of the time of two questions


def entry_point(of: T) -> T:
    """Make a function an entry point. Of a class, every public method and property becomes an entry
    point, with those inherited from its package.

    Examples:
        >>> @extend.entry_point
        ... def doubled(x):
        ...     return 2 * x
        >>> doubled(torch.ones(2))
        tensor([2., 2.])
    """
    if not isinstance(of, type):
        return _function(of)
    package = of.__module__.partition(".")[0]
    for kind in of.__mro__:
        if kind.__module__.partition(".")[0] == package:
            for name, value in list(vars(kind).items()):
                if (name in SPECIAL or not name.startswith("_")) and (
                    member := _member(value)
                ) is not value:
                    setattr(kind, name, member)
    return of


def entry_points(module: dict[str, Any], names: Iterable[str]) -> None:
    """Make the functions and classes of these names in a module's dictionary entry points. A
    function is an entry point under this module's name alone: imports from its own file are not
    wrapped.

    Examples:
        >>> module = {"__name__": "mine", "doubled": lambda x: 2 * x}
        >>> extend.entry_points(module, ["doubled"])
        >>> module["doubled"](torch.ones(2))
        tensor([2., 2.])
    """
    for name in names:
        value = module.get(name)
        if isinstance(value, type):
            entry_point(value)
        elif isinstance(value, types.FunctionType) and not hasattr(value, MARK):
            module[name] = entry_point(value)
            module[name].__module__ = module["__name__"]  # pickled, it is found again


def _function(function: Callable[..., Any]) -> Callable[..., Any]:
    @functools.wraps(function)
    def entered(*args: Any, **kwargs: Any) -> Any:
        try:
            if not autocast():
                return function(*args, **kwargs)
            with without_autocast():
                return function(*args, **kwargs)
        except TypeError as error:
            _add_arguments(error, function)
            raise

    return _left_alone(entered)


def _add_arguments(error: TypeError, function: Callable[..., Any]) -> None:
    """To Python's sentence that an argument is missing or too many: which ones there are."""
    sentence = str(error)
    if "argument" not in sentence or not sentence.startswith(f"{function.__qualname__}() "):
        return
    by: dict[bool, list[str]] = {True: [], False: []}
    for name, parameter in inspect.signature(function).parameters.items():
        if name not in ("self", "cls"):
            by[parameter.kind is parameter.KEYWORD_ONLY].append(name)
    names = ", ".join(by[False] + ["by name " + ", ".join(by[True])] * bool(by[True]))
    error.args = (f"{sentence}; it takes {names or 'none'}",)


def _getter(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """The same of a property, in less time: the library asks for these itself."""

    @functools.wraps(function)
    def entered(owner: Any) -> Any:
        if not autocast():
            return function(owner)
        with without_autocast():
            return function(owner)

    return _left_alone(entered)


def _left_alone(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function that torch.compile does not trace, nor what it calls: as `torch.compiler.disable`,
    without importing torch's compiler where torch has the names for it.
    """
    try:
        from torch._C._dynamo.eval_frame import (
            _FrameAction,
            _FrameExecStrategy,
            set_code_exec_strategy,
        )
    except ImportError:
        return torch.compiler.disable(function)
    setattr(function, MARK, True)
    set_code_exec_strategy(
        function.__code__, _FrameExecStrategy(_FrameAction.SKIP, _FrameAction.SKIP)
    )
    return function


def _member(value: Any) -> Any:
    """An attribute of a class as an entry point; as it is where it is no function."""
    if isinstance(value, types.FunctionType):
        return value if hasattr(value, MARK) else _function(value)
    if isinstance(value, (staticmethod, classmethod)):
        return value if hasattr(value.__func__, MARK) else type(value)(_function(value.__func__))
    if isinstance(value, property):
        return value if hasattr(value.fget, MARK) else value.getter(_getter(value.fget))
    if isinstance(value, cached) and not hasattr(value.func, MARK):
        value.func = _getter(value.func)
    return value


@contextmanager
def without_autocast() -> Iterator[None]:
    enabled = [device for device in DEVICES if torch.is_autocast_enabled(device)]
    try:
        for device in enabled:
            torch.set_autocast_enabled(device, False)
        yield
    finally:
        for device in enabled:
            torch.set_autocast_enabled(device, True)
