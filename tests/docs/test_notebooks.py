"""Notebooks of the tutorials: their cells are the blocks of the pages, which test_pages runs, and
they run in order; nothing in them points out of them.
"""

import json
import re

import pytest

from tests.cases.modules import ROOT, module_of

notebooks = module_of(ROOT / "docs" / "notebooks.py")


@pytest.mark.parametrize("name", notebooks.TUTORIALS)
def test_cells_are_the_page(name):
    page = (ROOT / "docs" / f"{name}.md").read_text()
    made = json.loads(notebooks.written(name))
    cells = made["cells"]
    code = [cell["source"] for cell in cells if cell["cell_type"] == "code"]
    blocks = [block.strip("\n") for block in re.findall(r"```python\n(.*?)```", page, re.S)]
    assert code == [block + notebooks.shown(block) for block in blocks]
    assert cells[0]["source"].startswith(page.splitlines()[0])
    assert len({cell["id"] for cell in cells}) == len(cells)
    assert all(re.fullmatch(r"[a-zA-Z0-9_-]{1,64}", cell["id"]) for cell in cells)
    for cell in cells:
        if cell["cell_type"] == "markdown":
            targets = re.findall(r"\]\(([^)\s]+)\)", cell["source"])
            assert targets == [f"attachment:{each}" for each in cell.get("attachments", {})]


def test_a_cell_shows_what_its_block_finds_and_draws():
    """Two numbers beside each other, and the picture, which is the last line."""
    assert notebooks.shown("a = 1") == notebooks.shown("found = 2") == ""
    block = "found, exact = 1, 2\nleft, ax = 3, 4"
    assert notebooks.shown(block) == '\nprint(f"found {found}, exact {exact}")\nax'


def test_a_notebook_runs(tmp_path, monkeypatch):
    """Cell by cell, as a kernel does, in an empty folder; what the last line of a cell gives is
    shown.
    """
    monkeypatch.chdir(tmp_path)
    names = {}
    for cell in notebooks.notebook("getting_started")["cells"]:
        if cell["cell_type"] == "code":
            exec(compile(cell["source"], cell["id"], "exec"), names)
    for shown in (names["scene"], names["solution"], names["state"]):
        assert "<table>" in shown._repr_html_()
