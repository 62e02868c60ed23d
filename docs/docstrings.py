"""Docstrings as the reference tool reads them, for mkdocs (`make docs`)."""

import re
from typing import Any

import griffe

GROUP = re.compile(r"^    (\*{0,2}\w+(?:, \*{0,2}\w+)+): (.*(?:\n {5,}.*)*)", re.M)


class NamesByThemselves(griffe.Extension):
    """`a, b: what both are` as two entries: the tool looks each name up in the signature."""

    def on_object(self, *, obj: griffe.Object, **kwargs: Any) -> None:
        if obj.docstring is not None:
            obj.docstring.value = GROUP.sub(_each, obj.docstring.value)


def _each(match: re.Match) -> str:
    return "\n".join(f"    {name}: {match.group(2)}" for name in match.group(1).split(", "))
