"""The README: its Python runs, its tables are those of the files, its pictures and links exist."""

import importlib.util
import re
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_python_runs(dtype, capsys, monkeypatch):
    """Top to bottom, as a newcomer types it in the root of the repository, in the default dtype and in float64."""
    monkeypatch.chdir(ROOT)
    monkeypatch.syspath_prepend(str(ROOT))
    torch.set_default_dtype(dtype)
    names: dict = {}
    for block in re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL):
        exec(block, names)
    assert names["tip"].shape == (3, 3) and torch.isfinite(names["force"].grad).all()
    assert "tensor" in capsys.readouterr().out


def test_tables_are_the_files():
    spec = importlib.util.spec_from_file_location("tables", ROOT / "docs" / "tables.py")
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    assert tables.filled(TEXT) == TEXT


def test_links_and_pictures_exist():
    for target in re.findall(r"\]\(([^)#]+)\)", TEXT):
        assert target.startswith("http") or (ROOT / target).exists(), target
