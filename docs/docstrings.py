"""Docstrings as the reference tool reads them (`make docs`)."""

import re
from collections.abc import Iterator
from typing import Any

import griffe

from torchbeam.core.docstrings import with_entries

FIELDS = ("branch", "leaf", "option", "field")
GROUP = re.compile(r"^    (\*{0,2}\w+(?:, \*{0,2}\w+)+): (.*(?:\n {5,}.*)*)", re.M)


class NamesByThemselves(griffe.Extension):
    """`a, b: what both are` as two entries: the tool looks each name up in the signature."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = GROUP.sub(_each, obj.docstring.value)


class FieldsByTheirDefaults(griffe.Extension):
    """`leaf(1, default=None)` of a dataclass as the field with a default that it is, so that the
    signature says `= None`, and nothing where there is none; `Sorted[accepted, held]` as what it
    accepts.
    """

    def on_attribute_instance(self, *, attr: griffe.Attribute, **kwargs: Any) -> None:
        call, kind = attr.value, attr.annotation
        if isinstance(kind, griffe.ExprSubscript) and str(kind.left) == "Sorted":
            attr.annotation = kind.slice.elements[0]
        if isinstance(call, griffe.ExprCall) and str(call.function) in FIELDS:
            given = [each for each in call.arguments if isinstance(each, griffe.ExprKeyword)]
            given = [
                griffe.ExprKeyword("default", "...")
                if each.name == "default_factory" and isinstance(each.value, griffe.ExprLambda)
                else each
                for each in given
            ] or [griffe.ExprKeyword("kw_only", "False")]
            attr.value = griffe.ExprCall(griffe.ExprName("dataclasses.field"), given)


class WhatIsWrapped(griffe.Extension):
    """A function under `@wraps(other)` with the signature and the docstring of the other, as
    Python itself shows it.
    """

    def on_package(self, *, pkg: griffe.Module, loader: griffe.GriffeLoader, **kwargs: Any) -> None:
        for function in _functions(pkg):
            for decorator in function.decorators:
                call = decorator.value
                if isinstance(call, griffe.ExprCall) and str(call.function) == "wraps":
                    other = _named(loader, call.arguments[0])
                    if other is not None:
                        function.parameters, function.returns = other.parameters, other.returns
                        function.docstring = other.docstring


class WhatRecordsSay(griffe.Extension):
    """A function under `@with_arguments_of(records)` with what these say of its arguments."""

    def on_package(self, *, pkg: griffe.Module, loader: griffe.GriffeLoader, **kwargs: Any) -> None:
        for function in _functions(pkg):
            for decorator in function.decorators:
                call = decorator.value
                if isinstance(call, griffe.ExprCall) and str(call.function) == "with_arguments_of":
                    for record in call.arguments:
                        said = loader.modules_collection[record.canonical_path].docstring.value
                        text = with_entries(function.docstring.value, said)
                        function.docstring.value = text


def _functions(scope: griffe.Object) -> Iterator[griffe.Function]:
    for member in scope.members.values():
        if isinstance(member, griffe.Function):
            yield member
        elif isinstance(member, griffe.Module | griffe.Class):
            yield from _functions(member)


def _named(loader: griffe.GriffeLoader, path: griffe.Expr) -> griffe.Function | None:
    """The function that an expression names, where the package itself has it."""
    try:
        other = loader.modules_collection[path.canonical_path]
    except KeyError:
        return None
    return other if isinstance(other, griffe.Function) else None


def _each(match: re.Match) -> str:
    return "\n".join(f"    {name}: {match.group(2)}" for name in match.group(1).split(", "))
