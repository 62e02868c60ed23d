"""Values of Python: which are known by themselves, whose they are, and what they hold."""

from __future__ import annotations

import builtins
import dis
import enum
import functools
import hashlib
import sys
import types
from collections import namedtuple
from collections.abc import Callable, Hashable, Iterator
from dataclasses import fields, is_dataclass, make_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

NUMBERS = (bool, int, float, complex, str, bytes)  # and words
OF_TORCH = torch.dtype, torch.device, torch.layout
STEADY = (*NUMBERS, type(None), type(Ellipsis), type(Path()), *OF_TORCH)
# fmt: off
PACKAGES = {  # of functions without memory
    "torch", "math", "cmath", "operator", "functools", "typing", "itertools", "collections",
    "dataclasses", "enum", "abc", __name__.split(".")[0],
}
PURE = {  # of Python's own
    "abs", "all", "any", "bool", "callable", "complex", "dict", "divmod", "enumerate", "filter",
    "float", "frozenset", "getattr",
    "hasattr", "int", "isinstance", "issubclass", "len", "list", "map", "max", "min", "pow",
    "range", "repr", "reversed",
    "round", "set", "slice", "sorted", "str", "sum", "super", "tuple", "type", "zip",
}
# fmt: on
FILES = {"load", "fromfile", "loadtxt", "genfromtxt", "memmap"}
PUT = (bool, int, float, complex, str, tuple, list, dict, Tensor)  # on modules
INSTALLED = {"site-packages", "dist-packages"}  # folders
ABSENT = object()
LARGE = 4096  # numbers of a tensor or an array, that are looked at each time
# what Python gives classes, and what only makes their objects
MADE = {
    "__post_init__",
    "__setattr__",
    "__new__",
    "__init_subclass__",
    *vars(make_dataclass("Empty", (), frozen=True, order=True)),
    *vars(namedtuple("Empty", ())),
}

Read = tuple[str, Callable[[], Any]]  # a name, and what gives what it stands for


def of_class(kind: type) -> Iterator[Read]:
    """What a user's classes give their objects beside fields: methods, properties, values."""
    field_names = {*getattr(kind, "__dataclass_fields__", ()), *getattr(kind, "_fields", ())} | MADE
    for parent in kind.__mro__:
        for name, value in () if of_package(parent) else vars(parent).items():
            if name not in field_names and (
                not name.startswith("__") or isinstance(value, types.FunctionType)
            ):
                yield (
                    name,
                    lambda parent=parent, name=name: function_of(vars(parent).get(name, ABSENT)),
                )


def function_of(value: Any) -> Any:
    """The function that a property, or a method of the class, is made from; all else as it is."""
    if isinstance(value, property):
        return value.fget
    if isinstance(value, functools.cached_property):
        return value.func
    return value.__func__ if isinstance(value, (staticmethod, classmethod)) else value


def class_attribute(kind: type, name: str) -> Any:
    return function_of(vars(kind).get(name, ABSENT))


def generated(value: Any) -> bool:
    """Whether it is a function that Python wrote, of a dataclass or of a named tuple."""
    return isinstance(value, types.FunctionType) and value.__code__.co_filename == "<string>"


def steady(value: Any) -> bool:
    """Whether it is a number or a word, or a tuple of such: known by itself. Not one of a user's
    class, which may hold more.
    """
    kind = type(value)
    if kind is tuple:
        return all(map(steady, value))
    return (
        kind in STEADY
        or (isinstance(value, np.generic) and kind.__module__ == "numpy")
        or (isinstance(value, enum.Enum) and not followed(value))
    )


def word_of(value: Any) -> Hashable:
    """Of what is steady: equal for the same numbers of the same kinds alone, 0.0 is not -0.0."""
    if type(value) is tuple:
        return tuple(map(word_of, value))
    return type(value), repr(value)


def number_of(value: Any) -> str | None:
    """The number or word of an object of a class derived from theirs, or an enumeration's name."""
    if isinstance(value, enum.Enum):
        return value.name
    for kind in NUMBERS:
        if isinstance(value, kind):
            return kind.__repr__(value)
    return None


def version_of(x: Tensor) -> tuple[int, bool, bytes | None]:
    """How often it was written to, whether it carries gradient, and what NumPy and `.data` write
    to unseen: its numbers, as long as they are not too many.
    """
    return x._version, x.requires_grad, bytes_of(x) if x.numel() <= LARGE else None


def bytes_of(x: Tensor) -> bytes | None:
    """Of its numbers; None where NumPy has no such."""
    try:
        return x.detach().numpy().tobytes()
    except (TypeError, RuntimeError):
        return None


def frozen(value: Any) -> bool:
    return is_dataclass(value) and not isinstance(value, type) and value.__dataclass_params__.frozen


def followed(value: Any) -> bool:
    """Whether it is a module of torch.nn or a user's, or of a user's or a frozen class."""
    if isinstance(value, types.ModuleType):
        name = value.__name__.split(".")[0]
        return name == "numpy" or name not in PACKAGES | sys.stdlib_module_names | {"__main__"}
    if isinstance(value, (type, types.FunctionType, types.BuiltinFunctionType, np.ufunc)):
        return False
    if isinstance(value, torch.nn.Module) or frozen(value):
        return True
    package = type(value).__module__.split(".")[0]
    return package == "__main__" or not (
        package in PACKAGES | {"numpy"} or package in sys.stdlib_module_names
    )


def put_on(module: types.ModuleType, names: set[str]) -> list[str]:
    """Of what code names in a module of `PACKAGES` numbers, tensors and users' functions, which may
    be put there by anyone; and modules in it, where the same may be so.
    """
    held = {name: vars(module)[name] for name in names & vars(module).keys()}
    kinds = (types.FunctionType, types.ModuleType)

    def counts(value: Any) -> bool:
        module = isinstance(value, types.ModuleType)
        return isinstance(value, PUT) or (isinstance(value, kinds) and of_package(value) == module)

    return [name for name, value in held.items() if counts(value)]


def attributes(value: Any) -> list[str]:
    """Names of what an object holds: a frozen dataclass's fields, else attributes and slots."""
    if frozen(value):
        return [field.name for field in fields(value)]
    if isinstance(value, Tensor):
        return [*vars(value), "requires_grad"]
    slots = (parent.__dict__.get("__slots__", ()) for parent in type(value).__mro__)
    return [
        *getattr(value, "__dict__", ()),
        *(name for some in slots for name in ((some,) if isinstance(some, str) else some)),
    ]


def lazy(kind: type, name: str) -> bool:
    """Whether an attribute is kept for a second use (`functools.cached_property`)."""
    return isinstance(getattr(kind, name, None), functools.cached_property)


def attribute(value: Any, name: str) -> Any:
    held = getattr(value, "__dict__", {})
    if name in held:
        return held[name]
    return getattr(value, name, ABSENT) if hasattr(type(value), name) else ABSENT


def of_numpy(value: Any) -> bool:
    """Whether it is a function, or type, of NumPy that reads no file and draws no number."""
    if isinstance(value, (types.ModuleType, np.ufunc)):
        return isinstance(value, np.ufunc)
    module = str(getattr(value, "__module__", ""))
    return (
        callable(value)
        and hasattr(value, "__name__")
        and module.split(".")[0] == "numpy"
        and not (module.startswith("numpy.random") or value.__name__ in FILES)
    )


def of_package(value: Any) -> bool:
    """Whether it is of one of `PACKAGES`, or of Python's own that are pure."""
    if isinstance(value, types.ModuleType):
        name = value.__name__
    elif callable(value) and hasattr(value, "__name__"):
        name = getattr(value, "__module__", None)
        if isinstance(value, types.BuiltinFunctionType):
            if not isinstance(value.__self__, (types.ModuleType, type, type(None))):
                return False  # a method of an object that it holds
            if name == builtins.__name__:
                return value.__name__ in PURE
        elif name is None and not isinstance(value, types.FunctionType):
            # one that is made by exec has none either
            name = type(value).__module__
        name = name or ""
    else:
        return False
    return name.split(".")[0] in PACKAGES or name == builtins.__name__


def top(value: Any) -> str:
    """First name of the module that a module, class or function is of."""
    module = isinstance(value, types.ModuleType)
    return str(value.__name__ if module else getattr(value, "__module__", None)).split(".")[0]


def installed(value: Any) -> bool:
    """Whether a module, class or function is of an installed package, not NumPy or `PACKAGES`."""
    name = top(value)
    file = str(getattr(sys.modules.get(name), "__file__", None) or "")
    return name not in PACKAGES | {"numpy"} and bool(INSTALLED & {*Path(file).parts})


def lasting(value: Any) -> Hashable:
    """What tells a value from others in any process, beside what it holds."""
    if steady(value):
        return word_of(value)
    if isinstance(value, Tensor):
        plain = value.detach().cpu().to_dense().resolve_conj().resolve_neg().contiguous()
        numbers = plain.flatten().view(torch.uint8).numpy().tobytes()
        return value.dtype, value.shape, hashlib.sha256(numbers).hexdigest()
    if isinstance(value, types.FunctionType) and not of_package(value) and not installed(value):
        return _of_code(value.__code__)
    if isinstance(value, (tuple, list, dict, set, frozenset)):
        return type(value).__qualname__, len(value)
    named = value if hasattr(value, "__name__") else type(value)
    release = getattr(sys.modules[top(named)], "__version__", "") if installed(named) else ""
    return top(named), getattr(named, "__qualname__", named.__name__), release


def _of_code(code: Any) -> Hashable:
    """What code does, and constants in it; without docstrings, names of files and line numbers."""
    if isinstance(code, types.CodeType):
        steps = dis.get_instructions(code)
        loaded = sorted({step.arg for step in steps if step.opcode in dis.hasconst})
        counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
        names = code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
        return code.co_code, counts, names, *(_of_code(code.co_consts[k]) for k in loaded)
    if isinstance(code, (tuple, frozenset)):
        parts = [repr(_of_code(part)) for part in code]
        return type(code), *(parts if isinstance(code, tuple) else sorted(parts))
    return word_of(code)


def contents(cell: Any) -> Any:
    """Of a variable that a function closes over; ABSENT before it is set."""
    try:
        return cell.cell_contents
    except ValueError:
        return ABSENT


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Code, and the code of functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from codes(constant)
