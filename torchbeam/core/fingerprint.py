"""Fingerprints: digests of functions and values, equal where code, constants and all that a
function finds around it are.
"""

from __future__ import annotations

import copyreg
import dis
import enum
import functools
import hashlib
import importlib
import inspect
import types
import weakref
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import torch
from torch import Tensor

from .installed import package, version_of
from .python_values import codes

# which attribute of a module they read, code does not say
BY_WORDS = {"getattr", "vars", "__dict__", "attrgetter"}
ABSENT = object()
PLAIN = (
    type(None),
    type(Ellipsis),
    type(NotImplemented),
    bool,
    int,
    float,
    complex,
    str,
    bytes,
    bytearray,
    range,
    slice,
    torch.dtype,
    torch.device,
    torch.memory_format,
    torch.layout,
)
NOT_OF_A_CLASS = {
    "__module__",
    "__doc__",
    "__dict__",
    "__weakref__",
    "__slotnames__",
    "__firstlineno__",
    "_abc_impl",
    "__static_attributes__",
    "__annotations__",
    "__annotate__",
    "__annotate_func__",
    "__annotations_cache__",
    "__abstractmethods__",
    "__dataclass_fields__",
    "__dataclass_params__",
    "__match_args__",
}


class NoFingerprint(ValueError):
    """Error: a value of which it cannot be said whether it has changed."""


def fingerprint(value: Any) -> tuple[dict[str, str], dict[str, str]]:
    """Fingerprint of a value: its parts, name -> digest (SHA-256, hexadecimal), and versions of the
    packages it uses, name -> version.

    Of a function the parts are its code with its defaults, its attributes, each variable that it
    closes over, and each global that it names, of modules what it names in them; functions among
    these have parts of their own. Of anything else there is one part, "": its type and content,
    attributes included.

    What is installed (torch, NumPy, ...) counts by its version, and what is not by its code.
    Comments, the text of docstrings, names of files and line numbers do not count. Raises
    NoFingerprint for what has neither code nor content to be read: open files, locks, compiled
    functions that belong to no package.
    """
    walk = _Walk()
    parts: dict[str, str] = {}
    waiting, met = [("", value)], {}
    for name, one in waiting:  # it grows on the way
        whole, one = one, _unwrapped(one)
        code = one.__func__ if inspect.ismethod(one) else one
        if not (isinstance(code, types.FunctionType) and walk.package(code) is None):
            parts[name] = walk.digest(one)
            continue
        if id(code) in met:
            parts[name] = f"as {met[id(code)]}"
        else:
            met[id(code)] = name
            parts[name] = walk.digest_of_code(code)
            waiting += [
                (f"{name}.{key}" if name else key, part)
                for key, part in (*_about(whole), *walk.around(code))
            ]
        if code is not one:
            waiting.append((f"{name}.self" if name else "self", one.__self__))
    return parts, dict(sorted(walk.versions.items()))


class _Walk:
    """Traversal of values, to their digests; `versions` of the packages met on the way."""

    def __init__(self) -> None:
        self.versions: dict[str, str] = {}
        # values that are being looked at, by depth: circles end here
        self.open: dict[int, int] = {}
        # digests by id, with the value so that no id is used again
        self.known: dict[int, tuple[str, Any]] = {}

    def digest(self, value: Any) -> str:
        """Digest of a value's type and content. Raises NoFingerprint."""
        if id(value) in self.open:
            return f"circle {len(self.open) - self.open[id(value)]}"
        if id(value) in self.known:
            return self.known[id(value)][0]
        self.open[id(value)] = len(self.open)
        try:
            sum_ = hashlib.sha256()
            for part in self.content(value):
                part = part if isinstance(part, bytes) else part.encode()
                sum_.update(len(part).to_bytes(8, "big") + part)
            self.known[id(value)] = sum_.hexdigest(), value
            return sum_.hexdigest()
        finally:
            del self.open[id(value)]

    def content(self, value: Any) -> Iterator[str | bytes]:
        """Text and bytes that say what a value is. Raises NoFingerprint."""
        if (inner := _unwrapped(value)) is not value:
            yield self.digest(inner)
            for name, part in _about(value):
                yield from (name, self.digest(part))
            return
        yield type(value).__qualname__
        # and classes derived from these
        if isinstance(value, (*PLAIN, Tensor, list, tuple, set, frozenset, dict)):
            if self.package(type(value)) is None:
                yield self.digest(type(value))
            for name, part in sorted(getattr(value, "__dict__", {}).items()):
                yield from (name, self.digest(part))
        if isinstance(value, PLAIN) and not isinstance(value, enum.Enum):
            yield repr(value)
        elif isinstance(value, Tensor):
            if type(value) is torch.nn.Parameter:
                yield str(value.requires_grad)
            yield from (str(value.dtype), str(value.device), repr(tuple(value.shape)))
            plain = value.detach().cpu().to_dense().resolve_conj().resolve_neg()
            yield plain.contiguous().flatten().view(torch.uint8).numpy().tobytes()
        elif isinstance(value, (list, tuple)):
            yield from map(self.digest, value)
        elif isinstance(value, (set, frozenset)):
            yield from sorted(map(self.digest, value))
        elif isinstance(value, (dict, types.MappingProxyType)):
            for key, item in value.items():
                yield from (self.digest(key), self.digest(item))
        elif isinstance(value, types.ModuleType):
            yield value.__name__
            if self.package(value) is None:  # all of it, where no code says what of it is read
                for name in sorted(name for name in vars(value) if not name.startswith("__")):
                    yield from (name, self.digest(vars(value)[name]))
        elif isinstance(value, types.CodeType):
            yield from self.code(value)
        elif inspect.ismethod(value):
            yield from (self.digest(value.__func__), self.digest(value.__self__))
        elif isinstance(value, types.FunctionType) and self.package(value) is None:
            yield self.digest_of_code(value)
            for name, part in self.around(value):
                yield from (name, self.digest(part))
        elif isinstance(value, type) and self.package(value) is None:
            yield from (value.__qualname__, *map(self.digest, (type(value), *value.__bases__)))
            for name in sorted(vars(value).keys() - NOT_OF_A_CLASS):
                yield from (name, self.digest(vars(value)[name]))
        elif isinstance(value, type) or (callable(value) and hasattr(value, "__qualname__")):
            if self.package(value) is None:
                raise NoFingerprint(f"{value!r}")
            yield from (str(getattr(value, "__module__", "")), value.__qualname__)
            owner = getattr(value, "__self__", None)  # of a built-in method
            if owner is not None and not isinstance(owner, (type, types.ModuleType)):
                yield self.digest(owner)
        else:
            yield self.digest(type(value))
            yield from self.state(value)

    def state(self, value: Any) -> Iterator[str | bytes]:
        """Content of an object: the fields of a dataclass; else what it has, less what it keeps for
        a second use; else what pickle would keep. Raises NoFingerprint.
        """
        if is_dataclass(value):
            held = {
                name: one
                for name, one in getattr(value, "__dict__", {}).items()
                if not _kept_for_later(type(value), name)
            }
            has = held | {field.name: getattr(value, field.name, None) for field in fields(value)}
        elif isinstance(value, enum.Enum):
            has = {"name": value.name, "value": value.value}
        elif isinstance(value, property):
            has = {"get": value.fget, "set": value.fset, "del": value.fdel}
        elif isinstance(value, types.MemberDescriptorType):
            has = {"name": value.__name__}
        else:
            try:
                # as pickle does: patterns, some releases' ufuncs
                reduced = copyreg.dispatch_table.get(type(value))
                reduction = value.__reduce_ex__(2) if reduced is None else reduced(value)
            except Exception:
                raise NoFingerprint(
                    f"a {type(value).__module__}.{type(value).__qualname__}"
                ) from None
            own = (
                type(value).__reduce_ex__ is object.__reduce_ex__
                and type(value).__reduce__ is object.__reduce__
            )
            if own and hasattr(value, "__dict__"):
                has = {
                    name: var
                    for name, var in vars(value).items()
                    if not _kept_for_later(type(value), name)
                }
                slots = {
                    name
                    for kind in type(value).__mro__
                    for name in _names(vars(kind).get("__slots__", ()))
                }
                has |= {
                    name: getattr(value, name)
                    for name in slots - {"__dict__", "__weakref__"}
                    if hasattr(value, name)
                }
            else:
                has = {
                    "kept": reduction
                    if isinstance(reduction, str)
                    else [list(x) if isinstance(x, Iterator) else x for x in reduction]
                }
        for name in sorted(has):
            yield from (name, self.digest(has[name]))

    def digest_of_code(self, function: types.FunctionType) -> str:
        """Digest of a function's code and defaults, without what is around them."""
        self.versions["python"] = version_of("python")
        return self.digest([function.__code__, function.__defaults__, function.__kwdefaults__])

    def code(self, code: types.CodeType) -> Iterator[str | bytes]:
        """Text and bytes that say what compiled code does; no docstring, names of files or line
        numbers.
        """
        yield code.co_code
        yield repr(
            (
                code.co_names,
                code.co_varnames,
                code.co_freevars,
                code.co_cellvars,
                code.co_argcount,
                code.co_posonlyargcount,
                code.co_kwonlyargcount,
                code.co_flags,
            )
        )
        # a docstring
        first = (
            1 if isinstance(next(iter(code.co_consts), None), str) and 0 not in _loaded(code) else 0
        )
        yield from map(self.digest, code.co_consts[first:])

    def around(self, function: types.FunctionType) -> Iterator[tuple[str, Any]]:
        """Attributes of a function, variables closed over and globals that its code, and code
        within it, reads, by name.
        """
        yield from _given(function)
        every = list(codes(function.__code__))
        names = sorted({name for code in every for name in code.co_names})
        for name, cell in zip(
            function.__code__.co_freevars, function.__closure__ or (), strict=True
        ):
            try:
                yield from self.named(name, cell.cell_contents, names)
            except ValueError:  # not set yet
                yield name, None
        steps = [step for code in every for step in dis.get_instructions(code)]
        for name in sorted(
            {step.argval for step in steps if step.opname in ("LOAD_GLOBAL", "LOAD_NAME")}
        ):
            if name in function.__globals__:
                yield from self.named(name, function.__globals__[name], names)
        for name in sorted({step.argval for step in steps if step.opname == "IMPORT_NAME"}):
            # as it is, or relative
            for full in (name, f"{function.__globals__.get('__package__')}.{name}"):
                try:
                    yield from self.named(full, importlib.import_module(full), names)
                    break
                except ImportError:
                    pass

    def named(
        self, name: str, value: Any, names: list[str], above: tuple[int, ...] = ()
    ) -> Iterator[tuple[str, Any]]:
        """Name and value; of a module those of what the code names in it. Of one that is installed
        this is what was put there since: its own functions count by its version.
        """
        if not isinstance(value, types.ModuleType) or BY_WORDS & {*names}:
            yield name, value
            return
        installed = self.package(value) is not None
        if installed:
            yield name, value
        for inner in names:
            part = vars(value).get(inner, ABSENT)
            if isinstance(part, types.ModuleType):
                if id(part) not in above:
                    yield from self.named(f"{name}.{inner}", part, names, (*above, id(value)))
            elif part is not ABSENT and (not installed or self.put_there(part)):
                yield f"{name}.{inner}", part

    def put_there(self, value: Any) -> bool:
        """Whether what stands in an installed module is a number or a tensor, or of no package."""
        if isinstance(value, (*PLAIN, Tensor, list, tuple)):
            return True
        code = callable(value) and hasattr(value, "__name__")
        return not isinstance(value, dict) and self.package(value if code else type(value)) is None

    def package(self, value: Any) -> str | None:
        """See `package`; its version counts from here on."""
        packaged = package(value)
        if packaged is not None and packaged not in self.versions:
            self.versions[packaged] = version_of(packaged)
        return packaged


def _unwrapped(value: Any) -> Any:
    """Function in a cache, a static or class method, or object of a weak reference; any other value
    as it is.
    """
    while True:
        if isinstance(value, functools._lru_cache_wrapper):
            value = value.__wrapped__
        elif isinstance(value, (staticmethod, classmethod)):
            value = value.__func__
        elif isinstance(value, functools.cached_property):
            value = value.func
        elif isinstance(value, weakref.ref):
            value = value()
        else:
            return value


def _about(value: Any) -> Iterator[tuple[str, Any]]:
    """Attributes that were given to the cache or method about a function."""
    while isinstance(value, (functools._lru_cache_wrapper, staticmethod, classmethod)):
        yield from _given(value)
        value = (
            value.__wrapped__ if isinstance(value, functools._lru_cache_wrapper) else value.__func__
        )


def _given(value: Any) -> Iterator[tuple[str, Any]]:
    """Attributes that a function, or what is about it, was given."""
    for name, item in sorted(getattr(value, "__dict__", {}).items()):
        if not name.startswith("__"):
            yield f"attribute {name}", item


def _loaded(code: types.CodeType) -> set[int]:
    """Indices of the constants that the code loads."""
    return {step.arg for step in dis.get_instructions(code) if step.opcode in dis.hasconst}


def _kept_for_later(kind: type, name: str) -> bool:
    """Whether an attribute is what a lazy property of the class has found
    (functools.cached_property and its likes), or what the object alone remembers, its name begun by
    a space, as copies and pickles go without it (`torchbeam.core.leaves.Tree`).
    """
    if name.startswith(" "):
        return True
    name = name.partition(" ")[0]  # of `torchbeam.core.derivatives.cached`, after the name its mode
    member = next((vars(k)[name] for k in kind.__mro__ if name in vars(k)), None)
    return (
        hasattr(member, "__get__")
        and not hasattr(member, "__set__")
        and not isinstance(member, types.FunctionType)
    )


def _names(slots: Any) -> tuple[str, ...]:
    """Names of `__slots__`, which may be one."""
    return (slots,) if isinstance(slots, str) else tuple(slots)
