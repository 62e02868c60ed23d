"""Surroundings of a function: what it reads beside its arguments, and whether that is as it was."""

from __future__ import annotations

import builtins
import dis
import enum
import functools
import sys
import types
from collections import namedtuple
from collections.abc import Callable, Hashable, Iterable, Iterator
from copy import copy
from dataclasses import fields, is_dataclass, make_dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

STEADY = (
    type(None),
    type(Ellipsis),
    bool,
    int,
    float,
    complex,
    str,
    bytes,
    torch.dtype,
    torch.device,
    torch.layout,
    enum.Enum,
    np.generic,
)
PACKAGES = {  # of functions without memory
    "torch",
    "math",
    "cmath",
    "operator",
    "functools",
    "typing",
    "itertools",
    "collections",
    "dataclasses",
    "enum",
    "abc",
    __name__.split(".")[0],
}
# fmt: off
PURE = {  # of Python's own
    "abs", "all", "any", "bool", "complex", "dict", "divmod", "enumerate", "filter", "float",
    "frozenset", "getattr",
    "hasattr", "int", "isinstance", "issubclass", "len", "list", "map", "max", "min", "pow",
    "range", "repr", "reversed",
    "round", "set", "slice", "sorted", "str", "sum", "super", "tuple", "type", "zip",
}
# fmt: on
# tensors count by their versions
WRITTEN = {"STORE_GLOBAL", "DELETE_GLOBAL", "STORE_ATTR", "DELETE_ATTR"}
READ = {"LOAD_ATTR", "LOAD_METHOD", "LOAD_SUPER_ATTR"}  # an attribute, by its name
# which attribute they read, code does not say
BY_WORDS = {"getattr", "hasattr", "vars", "__dict__", "attrgetter"}
# of torch.nn
OF_MODULES = {
    "_parameters",
    "_buffers",
    "_modules",
    "training",
    "_forward_hooks",
    "_forward_pre_hooks",
}
FILES = {"load", "fromfile", "loadtxt", "genfromtxt", "memmap"}
PUT = (bool, int, float, complex, str, tuple, list, dict, Tensor)  # on modules
ABSENT = object()
SMALL = 64  # numbers of a tensor by which it is known
LARGE = 4096  # numbers of an array of NumPy, that are looked at each time
# what Python gives classes, and what only makes their objects
MADE = {
    "__post_init__",
    "__setattr__",
    "__new__",
    "__init_subclass__",
    *vars(make_dataclass("Empty", (), frozen=True, order=True)),
    *vars(namedtuple("Empty", ())),
}

MAKES = ("__new__", "__init__", "__post_init__")  # an object

Read = tuple[str, Callable[[], Any]]  # a name, and what gives what it stands for


class Unsteady(ValueError):
    """Error: a function reads, or writes, what may be another thing at its next call."""


class Variable(NamedTuple):
    """What `read` gave, and of a tensor how often it had been written to, and whether it carried
    gradient.
    """

    read: Callable[[], Any]
    value: Any
    version: tuple[int, bool] | None

    def unchanged(self) -> bool:
        now = self.read()
        if now is not self.value:
            return _steady(now) and type(now) is type(self.value) and now == self.value
        return self.version is None or _version(now) == self.version


class Surroundings:
    """Variables that functions, and those that they call, close over and find in their modules:
    numbers, words, tensors, functions, lists, dictionaries and tuples, objects by those of their
    attributes that the functions name, classes by what they give their objects, and modules of
    torch.nn. Raises Unsteady, with what it is, for all else that may change unnoticed, for
    functions that write to what is around them, and for packages other than `PACKAGES`.

    inputs  tensors that a program takes as inputs, whatever their numbers: parameters and buffers
            of modules, and what carries gradient
    batched  by id, of those of them that hold a row for each sample: how many of their axes are the
             batch's
    """

    def __init__(self, reads: Iterable[Read] = ()) -> None:
        """reads: names, and what gives a function, or what it uses."""
        self.variables: list[Variable] = []
        self.inputs: list[Tensor] = []
        self.batched: dict[int, int] = {}
        self._met: dict[int, tuple[int, Any]] = {}  # by id: what was looked at, and as which
        self._named: set[str] = set()  # attributes, by code
        # objects and modules, with what of theirs was looked at
        self._holders: list[tuple[str, Any, set[str]]] = []
        self._buffers: set[int] = set()
        for name, read in reads:
            self._hold(name, read)
        while self._look():
            pass

    def unchanged(self) -> bool:
        return all(variable.unchanged() for variable in self.variables)

    @property
    def tensors(self) -> list[Tensor]:
        """Floating ones on the CPU."""
        return [
            x
            for _, x in self._met.values()
            if isinstance(x, Tensor) and x.is_floating_point() and x.device.type == "cpu"
        ]

    def by_sample(self, tensors: list[Tensor], axes: int) -> Surroundings:
        """The same with these of its tensors as inputs, whose first `axes` axes are those of a
        batch.
        """
        other = copy(self)
        other.batched = {id(x): axes for x in tensors}
        other.inputs = [*self.inputs, *(x for x in tensors if all(x is not y for y in self.inputs))]
        other.variables = [
            variable._replace(version=None) if id(variable.value) in other.batched else variable
            for variable in self.variables
        ]
        return other

    @property
    def key(self) -> tuple[Any, ...]:
        """Equal for equal surroundings, as long as these exist: users' functions count by their
        code, tuples, objects and dataclasses by their kind, with all that is in them, small tensors
        by their numbers, `inputs` by their shape.
        """
        return tuple(map(self._word, self.variables))

    def _word(self, variable: Variable) -> Hashable:
        value = variable.value
        if _steady(value):
            return type(value), value
        if any(value is x for x in self.inputs):
            axes = self.batched.get(id(value), 0)
            return value.dtype, value.shape[axes:], axes, self._met[id(value)][0]
        if (
            type(value) is Tensor
            and value.numel() <= SMALL
            and value.device.type == "cpu"
            and not value.requires_grad
        ):
            return value.dtype, value.shape, value.contiguous().numpy().tobytes()
        what = None
        if isinstance(value, types.FunctionType) and not _of_package(value):
            what = value.__code__
        elif isinstance(value, (tuple, list, dict, set)):
            what = type(value), len(value)
        elif isinstance(value, (np.ndarray, functools.partial, types.MethodType)) or (
            _followed(value) and not isinstance(value, types.ModuleType)
        ):
            what = type(value)
        # by which it is of those that were met, as the same one may stand in two places
        return (id(value), variable.version) if what is None else (what, self._met[id(value)][0])

    def _hold(self, name: str, read: Callable[[], Any]) -> None:
        value = read()
        self.variables.append(Variable(read, value, self._take(name, value)))

    def _take(self, name: str, value: Any) -> tuple[int, bool] | None:
        """Look at what a name stands for, and at what that reads; the version of a tensor."""
        if isinstance(value, Tensor):
            return self._tensor(name, value)
        if _steady(value) or id(value) in self._met:
            return None
        self._met[id(value)] = len(self._met), value
        if isinstance(value, (tuple, frozenset)):
            for part in value:
                self._part(name, part)
            self._class(type(value))
        elif isinstance(value, (list, dict)):
            self._contents(name, value)
        elif isinstance(value, set):
            self._hold(f"members of {name}", lambda: tuple(sorted(map(repr, value))))
        elif isinstance(value, np.ndarray):
            self._array(name, value)
        elif isinstance(value, functools.partial):
            self._part(name, value.func)
            self._part(name, value.args)
            self._contents(name, value.keywords)
        elif isinstance(value, types.FunctionType) and not (
            _of_package(value) or str(value.__module__).split(".")[0] == "numpy"
        ):
            self._function(value.__name__, value)
        elif isinstance(value, types.MethodType):
            self._part(name, value.__self__)
            self._part(name, value.__func__)
        elif _followed(value):
            self._holders.append((name, value, set()))
            if isinstance(value, torch.nn.Module):
                self._buffers |= {id(x) for x in value.buffers()}
                self._named.add("forward")
            self._class(type(value))
        elif isinstance(value, type) and not (_of_package(value) or _of_numpy(value)):
            self._class(value)
            self._class(type(value))
            for one in (*getattr(value, "__dataclass_fields__", ()), *MAKES):
                read = functools.partial(_of_class, value, one)
                if read() is not ABSENT and not _generated(read()):
                    self._hold(f"{name}.{one}", read)
        elif isinstance(value, types.ModuleType) and _of_package(value):
            self._holders.append((name, value, set()))
        elif not (_of_package(value) or _of_numpy(value)):
            kind = "a module" if isinstance(value, types.ModuleType) else type(value).__name__
            raise Unsteady(f"{name!r} ({kind})")
        return None

    def _tensor(self, name: str, value: Tensor) -> tuple[int, bool] | None:
        if value.is_inference():
            raise Unsteady(
                f"{name!r}, a tensor of inference mode, which does not tell whether it was "
                "written to"
            )
        if id(value) not in self._met:
            self._met[id(value)] = len(self._met), value
            own = (
                value.requires_grad
                or isinstance(value, torch.nn.Parameter)
                or id(value) in self._buffers
            )
            if own and value.is_floating_point() and value.device.type == "cpu":
                self.inputs.append(value)
        return None if any(value is x for x in self.inputs) else _version(value)

    def _contents(self, name: str, value: list | dict) -> None:
        """Of a list or dictionary, that may have others later."""
        if isinstance(value, list):
            self._hold(f"the length of {name}", lambda: len(value))
            for k in range(len(value)):
                self._hold(f"{name}[{k}]", lambda k=k: value[k] if k < len(value) else ABSENT)
            return
        self._hold(f"keys of {name}", lambda: tuple(value))
        for key in tuple(value):
            self._hold(f"{name}[{key!r}]", lambda key=key: value.get(key, ABSENT))

    def _array(self, name: str, value: np.ndarray) -> None:
        if value.size > LARGE or value.dtype.hasobject:
            raise Unsteady(f"{name!r}, an array of more than {LARGE} numbers")
        self._hold(f"numbers of {name}", lambda: (value.dtype.str, value.shape, value.tobytes()))

    def _class(self, kind: type) -> None:
        """What a user's class gives its objects: what is done to them without a name, and what
        functions name.
        """
        if any(not _of_package(parent) for parent in kind.__mro__):
            self._holders.append((kind.__name__, kind, set()))

    def _look(self) -> bool:
        """At what functions name of objects, classes and modules; whether there was anything
        new.
        """
        before = len(self.variables)
        for name, value, seen in self._holders:
            if isinstance(value, type):
                own = {one: read for one, read in of_class(value)}
                wanted = {one for one in own if one in self._named or one.startswith("__")}
            else:
                own = {
                    one: lambda value=value, one=one: _attribute(value, one)
                    for one in (
                        _put_on(value, self._named)
                        if isinstance(value, types.ModuleType) and _of_package(value)
                        else _attributes(value)
                    )
                }
                whole = not isinstance(value, types.ModuleType) and (
                    BY_WORDS & self._named or _of_package(type(value)) or _frozen(value)
                )
                wanted = {one for one in own if whole or one in self._named} | (
                    OF_MODULES & own.keys()
                )
            for one in sorted(wanted - seen):
                seen.add(one)
                self._hold(f"{name}.{one}", own[one])
        return len(self.variables) > before

    def _part(self, name: str, value: Any) -> None:
        """Of what cannot be made to hold another."""
        self._hold(name, lambda: value)

    def _function(self, name: str, function: types.FunctionType) -> None:
        for part in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self._part(f"a default of {name}", part)
        for own in vars(function):
            self._hold(f"{name}.{own}", lambda own=own: vars(function).get(own, ABSENT))
        for variable, cell in zip(
            function.__code__.co_freevars, function.__closure__ or (), strict=True
        ):
            self._hold(variable, lambda cell=cell: cell.cell_contents)
        for code in codes(function.__code__):
            for step in dis.get_instructions(code):
                self._step(name, function, step)

    def _step(self, name: str, function: types.FunctionType, step: dis.Instruction) -> None:
        """One of a function's code."""
        said = step.argval
        if step.opname in WRITTEN or (
            step.opname == "STORE_DEREF" and said in function.__code__.co_freevars
        ):
            raise Unsteady(f"{said!r}, which {name} writes to")
        if step.opname == "IMPORT_NAME":
            raise Unsteady(f"{said!r}, which {name} imports")
        if step.opname in READ:
            self._named.add(said)
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            self._named |= BY_WORDS & {said}
            self._global(function.__globals__, said)

    def _global(self, known: dict[str, Any], name: str) -> None:
        if name in known:
            self._hold(name, lambda: known.get(name, ABSENT))
        elif name not in PURE and not isinstance(getattr(builtins, name, None), type):
            raise Unsteady(f"{name!r}")


def of_class(kind: type) -> Iterator[Read]:
    """What the classes that a user wrote give their objects beside fields: methods, functions of
    properties, values.
    """
    own = {*getattr(kind, "__dataclass_fields__", ()), *getattr(kind, "_fields", ())} | MADE
    for parent in kind.__mro__:
        for name, value in () if _of_package(parent) else vars(parent).items():
            if name not in own and (
                not name.startswith("__") or isinstance(value, types.FunctionType)
            ):
                yield (
                    name,
                    lambda parent=parent, name=name: _function_of(vars(parent).get(name, ABSENT)),
                )


def _function_of(value: Any) -> Any:
    """The function that a property, or a method of the class, is made from; all else as it is."""
    return (
        value.fget
        if isinstance(value, property)
        else value.__func__
        if isinstance(value, (staticmethod, classmethod))
        else value
    )


def _of_class(kind: type, name: str) -> Any:
    return _function_of(vars(kind).get(name, ABSENT))


def _generated(value: Any) -> bool:
    """Whether it is a function that Python wrote, of a dataclass or of a named tuple."""
    return isinstance(value, types.FunctionType) and value.__code__.co_filename == "<string>"


def _steady(value: Any) -> bool:
    """Whether it is a number or a word, or a tuple of such: known by itself."""
    return isinstance(value, STEADY) or (type(value) is tuple and all(map(_steady, value)))


def _version(x: Tensor) -> tuple[int, bool]:
    return x._version, x.requires_grad


def _frozen(value: Any) -> bool:
    return is_dataclass(value) and not isinstance(value, type) and value.__dataclass_params__.frozen


def _followed(value: Any) -> bool:
    """Whether it is a module of torch.nn, a user's Python module, or an object of a user's class,
    or of a frozen one.
    """
    if isinstance(value, types.ModuleType):
        name = value.__name__.split(".")[0]
        return name == "numpy" or name not in PACKAGES | sys.stdlib_module_names | {"__main__"}
    if isinstance(value, (type, types.FunctionType, types.BuiltinFunctionType, np.ufunc)):
        return False
    if isinstance(value, torch.nn.Module) or _frozen(value):
        return True
    own = type(value).__module__.split(".")[0]
    return own == "__main__" or not (own in PACKAGES | {"numpy"} or own in sys.stdlib_module_names)


def _put_on(module: types.ModuleType, names: set[str]) -> list[str]:
    """Of what code names in a module of `PACKAGES` numbers, tensors and users' functions, which may
    be put there by anyone; and modules in it, where the same may be so.
    """
    held = {one: vars(module)[one] for one in names & vars(module).keys()}
    return [
        one
        for one, value in held.items()
        if isinstance(value, PUT)
        or (
            isinstance(value, (types.FunctionType, types.ModuleType))
            and _of_package(value) == isinstance(value, types.ModuleType)
        )
    ]


def _attributes(value: Any) -> list[str]:
    """Names of what an object holds: of a frozen dataclass its fields, else what it was given, also
    in slots.
    """
    if _frozen(value):
        return [field.name for field in fields(value)]
    slots = (parent.__dict__.get("__slots__", ()) for parent in type(value).__mro__)
    return [
        *getattr(value, "__dict__", ()),
        *(name for some in slots for name in ((some,) if isinstance(some, str) else some)),
    ]


def _attribute(value: Any, name: str) -> Any:
    held = getattr(value, "__dict__", {})
    return (
        held[name]
        if name in held
        else getattr(value, name, ABSENT)
        if hasattr(type(value), name)
        else ABSENT
    )


def _of_numpy(value: Any) -> bool:
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


def _of_package(value: Any) -> bool:
    """Whether a module, class, function or operation is of one of `PACKAGES`, or of Python's own
    that are pure.
    """
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


def codes(code: types.CodeType) -> Iterator[types.CodeType]:
    """Code, and the code of functions within it."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from codes(constant)
