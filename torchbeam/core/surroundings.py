"""Surroundings of a function: what it reads beside its arguments, and whether that is as it was."""

from __future__ import annotations

import builtins
import dis
import functools
import types
from collections import namedtuple
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import fields, is_dataclass, make_dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

STEADY = (type(None), type(Ellipsis), bool, int, float, complex, str, bytes, torch.dtype, torch.device, torch.layout)
PACKAGES = {"torch", "math", "cmath", "operator", "functools", "typing", __name__.split(".")[0]}  # of functions without memory
PURE = {  # of Python's own
    "abs", "all", "any", "bool", "complex", "dict", "divmod", "enumerate", "filter", "float", "frozenset", "getattr",
    "hasattr", "int", "isinstance", "issubclass", "len", "list", "map", "max", "min", "pow", "range", "repr", "reversed",
    "round", "set", "slice", "sorted", "str", "sum", "super", "tuple", "type", "zip",
}
RANDOM = {"normal", "normal_", "uniform_", "bernoulli", "bernoulli_", "multinomial", "dropout", "exponential_", "random_"}
WRITTEN = {"STORE_GLOBAL", "DELETE_GLOBAL", "STORE_ATTR", "DELETE_ATTR"}  # tensors count by their versions
ABSENT = object()
SMALL = 64  # numbers of a tensor by which it is known
# what Python gives classes, and what only makes their objects
MADE = {"__post_init__", *vars(make_dataclass("Empty", (), frozen=True, order=True)), *vars(namedtuple("Empty", ()))}

Read = tuple[str, Callable[[], Any]]  # a name, and what gives what it stands for


class Unsteady(ValueError):
    """Error: a function reads, or writes, what may be another thing at its next call."""


class Variable(NamedTuple):
    """What `read` gave, and of a tensor how often it had been written to."""

    read: Callable[[], Any]
    value: Any
    version: int | None

    def unchanged(self) -> bool:
        now = self.read()
        if now is not self.value:
            return isinstance(now, STEADY) and type(now) is type(self.value) and now == self.value
        return self.version is None or now._version == self.version


class Surroundings:
    """Variables that functions, and those that they call, close over and find in their modules: numbers, words, tensors,
    functions, and tuples and frozen dataclasses of such. Raises Unsteady, with what it is, for all else that may change
    unnoticed, for functions that write to what is around them or draw random numbers, and for packages other than `PACKAGES`.
    """

    def __init__(self, reads: Iterable[Read] = ()) -> None:
        """reads: names, and what gives a function, or what it uses."""
        self.variables: list[Variable] = []
        self._met: dict[int, tuple[int, Any]] = {}  # by id: what was looked at, and as which
        for name, read in reads:
            self._hold(name, read)

    def unchanged(self) -> bool:
        return all(one.unchanged() for one in self.variables)

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal for equal surroundings, as long as these exist: users' functions count by their code, tuples and dataclasses by
        their kind, with all that is in them, small tensors by their numbers.
        """
        return tuple(map(self._word, self.variables))

    def _word(self, one: Variable) -> Hashable:
        value = one.value
        if isinstance(value, STEADY):
            return type(value), value
        if type(value) is Tensor and value.numel() <= SMALL and value.device.type == "cpu" and not value.requires_grad:
            return value.dtype, value.shape, value.contiguous().numpy().tobytes()
        what = None
        if isinstance(value, types.FunctionType) and not _of_package(value):
            what = value.__code__
        elif isinstance(value, tuple):
            what = type(value), len(value)
        elif is_dataclass(value) and not isinstance(value, type):
            what = type(value)
        # by which it is of those that were met, as the same one may stand in two places
        return (id(value), one.version) if what is None else (what, self._met[id(value)][0])

    def _hold(self, name: str, read: Callable[[], Any]) -> None:
        value = read()
        self.variables.append(Variable(read, value, self._take(name, value)))

    def _take(self, name: str, value: Any) -> int | None:
        """Look at what a name stands for, and at what that reads; the version of a tensor."""
        if isinstance(value, STEADY) or id(value) in self._met:
            return None
        self._met[id(value)] = len(self._met), value
        if isinstance(value, Tensor):
            if value.is_inference():
                raise Unsteady(f"{name!r}, a tensor of inference mode, which does not tell whether it was written to")
            return value._version
        if isinstance(value, (tuple, frozenset)) or (is_dataclass(value) and _frozen(value)):
            for part in value if isinstance(value, (tuple, frozenset)) else (getattr(value, f.name) for f in fields(value)):
                self._part(name, part)
            for part, read in of_class(type(value)):
                self._hold(part, read)
        elif isinstance(value, functools.partial):
            for part in (value.func, *value.args, *value.keywords.values()):
                self._part(name, part)
        elif isinstance(value, types.FunctionType) and not _of_package(value):
            self._function(value.__name__, value)
        elif isinstance(value, types.MethodType):
            self._part(name, value.__self__)
            self._part(name, value.__func__)
        elif not _of_package(value):
            kind = "a module" if isinstance(value, types.ModuleType) else type(value).__name__
            raise Unsteady(f"{name!r} ({kind})")
        return None

    def _part(self, name: str, value: Any) -> None:
        """Of what cannot be made to hold another."""
        self._hold(name, lambda: value)

    def _function(self, name: str, function: types.FunctionType) -> None:
        for part in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self._part(f"a default of {name}", part)
        for own in vars(function):
            self._hold(f"{name}.{own}", lambda own=own: vars(function).get(own, ABSENT))
        for variable, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self._hold(variable, lambda cell=cell: cell.cell_contents)
        for code in codes(function.__code__):
            for step in dis.get_instructions(code):
                self._step(name, function, step)

    def _step(self, name: str, function: types.FunctionType, step: dis.Instruction) -> None:
        """One of a function's code."""
        said = step.argval
        if step.opname in WRITTEN or (step.opname == "STORE_DEREF" and said in function.__code__.co_freevars):
            raise Unsteady(f"{said!r}, which {name} writes to")
        if step.opname == "IMPORT_NAME":
            raise Unsteady(f"{said!r}, which {name} imports")
        if step.opname.startswith("LOAD_") and isinstance(said, str) and step.opcode not in dis.hasconst and (
                said in RANDOM or said.startswith("rand")):
            raise Unsteady(f"random numbers, by {said!r}")
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            self._global(function.__globals__, said)

    def _global(self, known: dict[str, Any], name: str) -> None:
        if name in known:
            self._hold(name, lambda: known.get(name, ABSENT))
        elif name not in PURE and not isinstance(getattr(builtins, name, None), type):
            raise Unsteady(f"{name!r}")


def of_class(kind: type) -> Iterator[Read]:
    """What the classes that a user wrote give their objects beside fields: methods, functions of properties, values."""
    own = {*getattr(kind, "__dataclass_fields__", ()), *getattr(kind, "_fields", ())} | MADE
    for one in kind.__mro__:
        for name, value in () if _of_package(one) else vars(one).items():
            if name not in own and (not name.startswith("__") or isinstance(value, types.FunctionType)):
                yield name, lambda one=one, name=name: _function_of(vars(one).get(name, ABSENT))


def _function_of(value: Any) -> Any:
    """The function that a property, or a method of the class, is made from; all else as it is."""
    return value.fget if isinstance(value, property) else value.__func__ if isinstance(
        value, (staticmethod, classmethod)) else value


def _frozen(value: Any) -> bool:
    return not isinstance(value, type) and value.__dataclass_params__.frozen


def _of_package(value: Any) -> bool:
    """Whether a module, class, function or operation is of one of `PACKAGES`, or of Python's own that are pure."""
    if isinstance(value, types.ModuleType):
        name = value.__name__
    elif callable(value) and hasattr(value, "__name__"):
        name = getattr(value, "__module__", None)
        if isinstance(value, types.BuiltinFunctionType):
            if not isinstance(value.__self__, (types.ModuleType, type, type(None))):
                return False  # a method of an object that it holds
            if name == builtins.__name__:
                return value.__name__ in PURE
        elif name is None and not isinstance(value, types.FunctionType):  # one that is made by exec has none either
            name = type(value).__module__
        name = name or ""
    else:
        return False
    return name.split(".")[0] in PACKAGES or name == builtins.__name__


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Code, and the code of functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from codes(constant)
