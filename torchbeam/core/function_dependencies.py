"""Dependencies of a function: what it reads beside its arguments, and whether that is as it was."""

from __future__ import annotations

import builtins
import dis
import functools
import hashlib
import re
import sys
import types
from collections.abc import Callable, Hashable, Iterable
from copy import copy
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from .python_values import (
    ABSENT,
    LARGE,
    PURE,
    Read,
    attribute,
    attributes,
    bytes_of,
    class_attribute,
    codes,
    contents,
    followed,
    frozen,
    generated,
    installed,
    lasting,
    lazy,
    number_of,
    of_class,
    of_numpy,
    of_package,
    put_on,
    steady,
    top,
    version_of,
    word_of,
)

# tensors count by their versions
WRITTEN = {"STORE_GLOBAL", "DELETE_GLOBAL", "STORE_ATTR", "DELETE_ATTR"}
READ = {"LOAD_ATTR", "LOAD_METHOD", "LOAD_SUPER_ATTR"}  # an attribute, by its name
# which attribute they read, code does not say
BY_WORDS = {"getattr", "hasattr", "vars", "__dict__", "attrgetter"}
# fmt: off
OF_MODULES = {  # of torch.nn
    "_parameters", "_buffers", "_modules", "training", "_forward_hooks", "_forward_pre_hooks",
}
# fmt: on
# what may hold attributes beside its contents
HOLDING = (tuple, frozenset, list, dict, set, np.ndarray, functools.partial)
SMALL = 64  # numbers of a tensor by which it is known
# what operations of torch go by, beside their arguments
DTYPE: Read = ("the default dtype", torch.get_default_dtype)
STATES = {
    "get_num_threads",
    "get_num_interop_threads",
    "get_float32_matmul_precision",
    "are_deterministic_algorithms_enabled",
}
MAKES = ("__new__", "__init__", "__post_init__")  # an object
PLAIN = {"torch", "types"}  # whose objects are what they hold: distributions, namespaces
WHOLE = re.compile(r"(?:.* of )?([^\[]*).*", re.S)  # what a member's name begins with
NAMED = (type, types.ModuleType, types.FunctionType, types.BuiltinFunctionType)


class Unsteady(ValueError):
    """Error: a function reads, or writes, what may be another thing at its next call."""


class Variable(NamedTuple):
    """What `read` gave, and of a tensor its `version_of`."""

    name: str
    read: Callable[[], Any]
    value: Any
    version: Hashable | None

    def unchanged(self) -> bool:
        now = self.read()
        if now is not self.value:
            return steady(now) and steady(self.value) and word_of(now) == word_of(self.value)
        return self.version is None or version_of(now) == self.version


class Dependencies:
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

    def __init__(self, reads: Iterable[Read] = (), strict: bool = True) -> None:
        """reads: names, and what gives a function, or what it uses. Where this is not `strict`,
        what would raise Unsteady is put down in `unseen`, but for what functions write to, and
        what is installed counts by its name.
        """
        self.strict, self.unseen = strict, []
        self.variables: list[Variable] = []
        self.inputs: list[Tensor] = []
        self.batched: dict[int, int] = {}
        self._met: dict[int, tuple[int, Any]] = {}  # by id: what was looked at, and as which
        self._named: set[str] = set()  # attributes, by code
        # objects and modules, with what of theirs was looked at
        self._holders: list[tuple[str, Any, set[str]]] = []
        self._buffers: set[int] = set()
        self._many: dict[int, int] = {}  # by id: numbers of large tensors, as they were
        for name, read in reads:
            self._hold(name, read)
        if self.variables:
            self._hold(*DTYPE)
        while self._look():
            pass

    def unchanged(self) -> bool:
        return all(variable.unchanged() for variable in self.variables)

    @property
    def tensors(self) -> list[Tensor]:
        """Floating ones on the CPU."""
        met = [x for _, x in self._met.values() if isinstance(x, Tensor)]
        return [x for x in met if x.is_floating_point() and x.device.type == "cpu"]

    def by_sample(self, tensors: list[Tensor], axes: int) -> Dependencies:
        """The same with these of its tensors as inputs, whose first `axes` axes are a batch's."""
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
        """Equal for equal dependencies, as long as these exist: users' functions count by their
        code, tuples, objects and dataclasses by their kind, with all that is in them, small tensors
        by their numbers, `inputs` by their shape.
        """
        return tuple(map(self._word, self.variables))

    def digests(self) -> dict[str, str]:
        """Of each variable with its members, by name, a digest that is the same in another
        process: of numbers and tensors by themselves, of functions by their code, of all else by
        its kind, as what it holds is a variable too.
        """
        sums: dict[str, Any] = {}
        first: dict[int, str] = {}  # by id: the name that stood for it first
        for name, _, value, _ in self.variables:
            known = "" if steady(value) else first.setdefault(id(value), name)
            words = known, lasting(value)
            if name != DTYPE[0]:
                whole = WHOLE.fullmatch(name)[1]
                sums.setdefault(whole, hashlib.sha256()).update(repr(words).encode())
        return {name: sum_.hexdigest() for name, sum_ in sums.items()}

    def _word(self, variable: Variable) -> Hashable:
        value = variable.value
        if steady(value):
            return word_of(value)
        if any(value is x for x in self.inputs):
            axes = self.batched.get(id(value), 0)
            return value.dtype, value.shape[axes:], axes, self._met[id(value)][0]
        small = type(value) is Tensor and value.numel() <= SMALL
        if small and value.device.type == "cpu" and not value.requires_grad:
            return value.dtype, value.shape, bytes_of(value)
        kind = None
        if isinstance(value, types.FunctionType) and not of_package(value):
            kind = value.__code__
        elif isinstance(value, (tuple, list, dict, set)):
            kind = type(value), len(value)
        elif isinstance(value, (np.ndarray, functools.partial, types.MethodType)) or (
            followed(value) and not isinstance(value, types.ModuleType)
        ):
            kind = type(value)
        if kind is None:
            return id(value), variable.version, self._many.get(id(value))
        # by which it is of those that were met, as the same one may stand in two places
        return kind, self._met[id(value)][0]

    def _hold(self, name: str, read: Callable[[], Any]) -> None:
        value = read()
        self.variables.append(Variable(name, read, value, self._take(name, value)))

    def _refuse(self, reason: str) -> None:
        if self.strict:
            raise Unsteady(reason)
        if reason not in self.unseen:
            self.unseen.append(reason)

    def _take(self, name: str, value: Any) -> Hashable | None:
        """Look at what a name stands for, and at what that reads; the version of a tensor."""
        if isinstance(value, Tensor):
            return self._tensor(name, value)
        if (
            steady(value)
            or id(value) in self._met
            or isinstance(value, types.MemberDescriptorType)  # of a slot
        ):
            return None
        self._met[id(value)] = len(self._met), value
        if isinstance(value, HOLDING):
            self._object(name, value)
        if isinstance(value, (tuple, frozenset)):
            for k, part in enumerate(
                value if isinstance(value, tuple) else sorted(value, key=repr)
            ):
                self._part(f"{name}[{k}]", part)
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
            of_package(value) or str(value.__module__).split(".")[0] == "numpy"
        ):
            self._function(value.__name__, value)
        elif isinstance(value, types.MethodType):
            self._part(name, value.__self__)
            self._part(name, value.__func__)
        elif not self.strict and isinstance(value, NAMED) and installed(value):
            return None
        elif followed(value) and (self.strict or not installed(type(value))):
            self._object(name, value)
            if isinstance(value, torch.nn.Module):
                self._buffers |= {id(x) for x in value.buffers()}
                self._named.add("forward")
            if (number := number_of(value)) is not None:
                self._hold(f"the value of {name}", lambda: number)
        elif isinstance(value, type) and not (of_package(value) or of_numpy(value)):
            self._class(value)
            self._class(type(value))
            for member in (*getattr(value, "__dataclass_fields__", ()), *MAKES):
                read = functools.partial(class_attribute, value, member)
                if read() is not ABSENT and not generated(read()):
                    self._hold(f"{name}.{member}", read)
        elif (isinstance(value, types.ModuleType) and of_package(value)) or (
            not self.strict and hasattr(value, "__dict__") and top(type(value)) in PLAIN
        ):
            self._holders.append((name, value, set()))
        elif not (of_package(value) or of_numpy(value)):
            kind = "a module" if isinstance(value, types.ModuleType) else type(value).__name__
            self._refuse(f"{name!r} ({kind})")
        return None

    def _object(self, name: str, value: Any) -> None:
        """What it was given, and what its class gives it."""
        self._holders.append((name, value, set()))
        if type(value) is not np.ndarray:
            self._class(type(value))

    def _tensor(self, name: str, value: Tensor) -> Hashable | None:
        if value.is_inference() and self.strict:
            raise Unsteady(
                f"{name!r}, a tensor of inference mode, which does not tell whether it was "
                "written to"
            )
        if id(value) not in self._met:
            self._met[id(value)] = len(self._met), value
            self._object(name, value)
            parameter = isinstance(value, torch.nn.Parameter) or id(value) in self._buffers
            varies = value.requires_grad or parameter
            if varies and value.is_floating_point() and value.device.type == "cpu":
                self.inputs.append(value)
        if any(value is x for x in self.inputs):
            return None
        if value.numel() > LARGE:
            self._many.setdefault(id(value), hash(bytes_of(value)))
        return version_of(value)

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
        if value.dtype.hasobject or (value.size > LARGE and self.strict):
            self._refuse(f"{name!r}, an array of more than {LARGE} numbers")
        self._hold(f"numbers of {name}", lambda: (value.dtype.str, value.shape, value.tobytes()))

    def _class(self, kind: type) -> None:
        """What a user's class gives its objects: special methods, and what functions name."""
        if any(not of_package(parent) for parent in kind.__mro__):
            self._holders.append((kind.__name__, kind, set()))

    def _look(self) -> bool:
        """At what functions name of objects, classes and modules; whether any of it was new."""
        before = len(self.variables)
        for name, value, seen in self._holders:
            if isinstance(value, type):
                reads = dict(of_class(value))
                named = {key for key in reads if key in self._named or key.startswith("__")}
                wanted = named if self.strict else {*reads}
            else:
                reads, whole = self._attributes(name, value)
                wanted = {key for key in reads if whole or key in self._named}
                wanted |= OF_MODULES & reads.keys()
                if not self.strict:
                    wanted -= {key for key in reads if lazy(type(value), key)}
            for key in sorted(wanted - seen):
                seen.add(key)
                self._hold(f"{name}.{key}", reads[key])
        return len(self.variables) > before

    def _attributes(self, name: str, value: Any) -> tuple[dict[str, Callable[[], Any]], bool]:
        """What an object or a module holds, and whether all of it counts, named or not."""
        module = isinstance(value, types.ModuleType)
        packaged = module and of_package(value)
        names = put_on(value, self._named) if packaged else attributes(value)
        reads = {key: functools.partial(attribute, value, key) for key in names}
        if module:
            users = not packaged and top(value) != "numpy"
            if users and not self.strict and BY_WORDS & self._named:
                self._refuse(f"{name!r} by getattr or the like")
            return reads, False
        whole = BY_WORDS & self._named or frozen(value)
        if not isinstance(value, Tensor):
            packaged = of_package(type(value)) and not isinstance(value, HOLDING)
            whole = whole or packaged or not self.strict
        return reads, bool(whole)

    def _part(self, name: str, value: Any) -> None:
        """Of what cannot be made to hold another."""
        self._hold(name, lambda: value)

    def _function(self, name: str, function: types.FunctionType) -> None:
        for part in (*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()):
            self._part(f"a default of {name}", part)
        for key in vars(function):
            self._hold(f"{name}.{key}", lambda key=key: vars(function).get(key, ABSENT))
        for variable, cell in zip(
            function.__code__.co_freevars, function.__closure__ or (), strict=True
        ):
            self._hold(variable, functools.partial(contents, cell))
        for code in codes(function.__code__):
            for step in dis.get_instructions(code):
                self._step(name, function, step)

    def _step(self, name: str, function: types.FunctionType, step: dis.Instruction) -> None:
        """One of a function's code."""
        said = step.argval
        if self.strict and (
            step.opname in WRITTEN
            or (step.opname == "STORE_DEREF" and said in function.__code__.co_freevars)
        ):
            raise Unsteady(f"{said!r}, which {name} writes to")
        if step.opname == "IMPORT_NAME":
            if self.strict or said not in sys.modules:
                self._refuse(f"{said!r}, which {name} imports")
            else:
                self._hold(said, lambda: sys.modules[said])
        if step.opname in READ:
            self._named.add(said)
        if said in STATES and step.opname in {*READ, "LOAD_GLOBAL", "LOAD_NAME"}:
            self._hold(f"torch.{said}()", getattr(torch, said))
        if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            self._named |= BY_WORDS & {said}
            self._global(function.__globals__, said)

    def _global(self, known: dict[str, Any], name: str) -> None:
        if name in known:
            self._hold(name, lambda: known.get(name, ABSENT))
        elif name not in PURE and not isinstance(getattr(builtins, name, None), type):
            self._refuse(f"{name!r}")
