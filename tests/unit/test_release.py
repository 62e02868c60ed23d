"""A release: one version and one date in all files that say them, a section of the changelog that
is read in two minutes, archives that hold what they should, and a wheel that works where nothing
else is installed.
"""

import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

import torchbeam as tb

tomllib = pytest.importorskip("tomllib", reason="Python 3.11 or later reads pyproject.toml")
ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
WORDS = 480  # at 240 a minute
GRADIENT = """
import torch, torchbeam as tb
force = torch.tensor([0, 0, 1.0], requires_grad=True)
section = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
scene = tb.Scene(tb.Beam.straight(1.0, 8, section), [tb.TipLoad(force=force)])
solution = tb.simulate(scene, torch.linspace(0, 0.1, 11), step=0.01)
solution.tip.position[-1, 2].backward()
assert solution.stats.engine == "native" and force.grad[2] > 0, (solution.stats, force.grad)
"""


def released():
    """Version, date and text of the changelog's first section that has a date."""
    text = (ROOT / "CHANGELOG.md").read_text()
    return re.search(
        r"^## ([0-9.]+) \((\d{4}-\d\d-\d\d)\)\n(.*?)(?=^## )", text, re.DOTALL | re.MULTILINE
    ).groups()


def test_all_files_name_one_version():
    version, date, _ = released()
    assert tb.__version__ == version
    citation = (ROOT / "CITATION.cff").read_text()
    assert version == PROJECT["version"]
    assert f"\nversion: {version}\n" in citation and f"\ndate-released: {date}\n" in citation


def test_a_user_reads_the_section_in_two_minutes():
    assert len(released()[2].split()) <= WORDS


def test_native_code_is_installed_with_the_library():
    assert any(name.startswith("llvmlite") for name in PROJECT["dependencies"])


@pytest.fixture(scope="module")
def archives(tmp_path_factory):
    """Of the source and the wheel: those of `make dist`, or built here."""
    folder = os.environ.get("TORCHBEAM_DIST") or str(tmp_path_factory.mktemp("dist"))
    if not list(Path(folder).glob("*.whl")):
        subprocess.run([sys.executable, "-m", "build", "--outdir", folder], cwd=ROOT, check=True)
    return next(Path(folder).glob("*.tar.gz")), next(Path(folder).glob("*.whl"))


@pytest.mark.long
def test_archives_hold_the_packages(archives):
    source, wheel = archives
    wanted = {
        f"{name}/{path.relative_to(ROOT / folder)}"
        for name, folder in (("torchbeam", "torchbeam"), ("torchbeam_envs", "envs"))
        for path in (ROOT / folder).rglob("*.py")
    }
    held = set(zipfile.ZipFile(wheel).namelist())
    assert wanted <= held and "torchbeam/py.typed" in held
    assert {name.split("/")[0] for name in held if ".dist-info/" not in name} == {
        "torchbeam",
        "torchbeam_envs",
    }
    with tarfile.open(source) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert {"README.md", "LICENSE", "pyproject.toml", "torchbeam/__init__.py"} <= names


@pytest.mark.long
def test_the_wheel_works_in_an_empty_environment(archives, tmp_path):
    """With the extra of the demo alone, away from the repository."""
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"

    def run(*arguments):
        own = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "TORCHBEAM_ENGINE")}
        done = subprocess.run(
            [python, *arguments], cwd=tmp_path, env=own, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done

    run("-m", "pip", "install", "--quiet", "torch==2.13.0")
    run("-m", "pip", "install", "--quiet", f"{archives[1]}[demo]")
    assert str(tmp_path) in run("-c", "import torchbeam; print(torchbeam.__file__)").stdout
    run("-W", "error::UserWarning", "-c", GRADIENT)
    run("-m", "torchbeam", "demo", "--out", "out")
    assert list((tmp_path / "out").iterdir())
