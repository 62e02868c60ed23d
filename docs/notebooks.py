"""Tutorials as notebooks, made of their pages: `python docs/notebooks.py out/notebooks` makes them;
the site has each for download on its page. Text and blocks are those of the page, pictures come
along, links lose their targets. Cells show what their block assigns to `found`, `exact` and `ax`.
"""

import ast
import base64
import json
import re
import sys
from pathlib import Path

DOCS = Path(__file__).parent
TUTORIALS = (
    "getting_started", "textbook", "applications", "statics", "structures", "gradients",
    "identification", "uncertainty",
)  # fmt: skip
BLOCK = re.compile(r"^```python\n(.*?)^```\n?", re.M | re.S)
PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)]+\.(?:png|gif))\)")
LINK = re.compile(r"(?<!!)\[([^\]\[]*)\]\((?!attachment:)[^)\s]+\)")


def notebook(name: str) -> dict:
    """The notebook of a page, as nbformat 4.5 has it."""
    text = (DOCS / f"{name}.md").read_text()
    cells = []
    for k, part in enumerate(BLOCK.split(text)):
        if part.strip():
            part = part.strip("\n")
            made = code(part + shown(part), f"{name}-{k}") if k % 2 else words(part, f"{name}-{k}")
            cells.append(made)
    return {
        "cells": cells,
        "metadata": {
            "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
            "language_info": {"name": "python"},
        },
        "nbformat": 4,
        "nbformat_minor": 5,
    }


def shown(block: str) -> str:
    """Lines that show what a block finds and draws."""
    assigned = {
        name.id
        for line in ast.walk(ast.parse(block))
        if isinstance(line, ast.Assign)
        for name in ast.walk(ast.Tuple(line.targets))
        if isinstance(name, ast.Name)
    }
    beside = '\nprint(f"found {found}, exact {exact}")' * ({"found", "exact"} <= assigned)
    return beside + "\nax" * ("ax" in assigned)


def code(text: str, key: str) -> dict:
    return {
        "cell_type": "code",
        "id": key,
        "execution_count": None,
        "metadata": {},
        "outputs": [],
        "source": text,
    }


def words(text: str, key: str) -> dict:
    """A cell of Markdown with its pictures."""
    pictures = {}

    def attached(match: re.Match) -> str:
        path = DOCS / match.group(2)
        kind = f"image/{path.suffix[1:]}"
        pictures[path.name] = {kind: base64.b64encode(path.read_bytes()).decode()}
        return f"![{match.group(1)}](attachment:{path.name})"

    text = LINK.sub(r"\1", PICTURE.sub(attached, re.sub(r"<!--.*?-->\n?", "", text, flags=re.S)))
    cell = {"cell_type": "markdown", "id": key, "metadata": {}, "source": text}
    return cell | ({"attachments": pictures} if pictures else {})


def written(name: str) -> str:
    return json.dumps(notebook(name), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    for name in TUTORIALS:
        (folder / f"{name}.ipynb").write_text(written(name))
