"""Pictures of the page of textbook problems: `python docs/textbook.py` runs its blocks and keeps
what each draws in docs/figures/textbook.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torchbeam as tb

DOCS = Path(__file__).parent


def picture_of(title: str) -> Path:
    """The picture of the problem with this heading."""
    return DOCS / "figures/textbook" / f"{title.lower().replace(' ', '-')}.png"


def problems() -> Iterator[tuple[str, dict[str, Any]]]:
    """Of each problem its heading and the names after its block."""
    names: dict[str, Any] = {}
    for section in re.split(r"^#+ ", (DOCS / "textbook.md").read_text(), flags=re.M)[1:]:
        title = section.partition("\n")[0]
        for block in re.findall(r"```python\n(.*?)```", section, re.DOTALL):
            exec(compile(block, title, "exec"), names)
            yield title, names


if __name__ == "__main__":
    for title, names in problems():
        if "ax" in names:
            print(tb.plot.save(names["ax"], picture_of(title), dpi=90))
