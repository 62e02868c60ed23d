"""What a wheel holds: every package of the repository, under the name that it is imported by, and
nothing that is not there.
"""

from pathlib import Path

import pytest

tomllib = pytest.importorskip("tomllib", reason="Python 3.11 or later reads pyproject.toml")
ROOT = Path(__file__).parents[2]
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
FOLDERS = {"torchbeam": "torchbeam", "torchbeam_envs": "envs"}


def packages():
    """Dotted name -> folder, of each folder with an __init__.py."""
    return {
        ".".join((name, *path.parent.relative_to(ROOT / folder).parts)): path.parent
        for name, folder in FOLDERS.items()
        for path in (ROOT / folder).rglob("__init__.py")
    }


def test_every_package_is_in_the_wheel():
    listed = SETUPTOOLS["packages"]
    assert sorted(listed) == sorted(packages()) and len(listed) == len(set(listed))


def test_every_module_is_in_a_package():
    """A folder of modules without __init__.py would import here and be missing there."""
    known = set(packages().values())
    modules = [path for folder in FOLDERS.values() for path in (ROOT / folder).rglob("*.py")]
    assert [str(path) for path in modules if path.parent not in known] == []


def test_every_package_comes_from_its_folder():
    """setuptools looks for a package in the folder of its longest listed parent."""
    folders = SETUPTOOLS["package-dir"]
    for name, folder in packages().items():
        parent, inside = name, []
        while parent not in folders:
            parent, _, last = parent.rpartition(".")
            inside.insert(0, last)
        assert ROOT.joinpath(folders[parent], *inside) == folder, name


def test_every_file_of_data_is_in_the_wheel():
    found = {
        path
        for pattern in SETUPTOOLS["package-data"]["torchbeam"]
        for path in (ROOT / "torchbeam").glob(pattern)
    }
    other = {
        path
        for path in (ROOT / "torchbeam").rglob("*")
        if path.is_file() and path.suffix not in (".py", ".pyc")
    }
    assert other == found
