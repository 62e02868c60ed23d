"""docs/compiled_engine.md: the folders, modules, variables and refusals that it names are there,
and nothing is left out.
"""

import re
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import torchbeam as tb
from studies.bench.stored import GROWTH
from torchbeam.engine.chain.coverage import ENGINES, VARIABLE
from torchbeam.engine.compiler.object_cache import default_folder

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "compiled_engine.md").read_text()


SECTION = tb.Section.from_stiffness(EA=4e4, GA=1.5e4, GJ=0.8, EI=1.0, mass=0.2, inertia=5e-6)


def scene(**options):
    return tb.Scene(tb.Beam.straight(1.0, 2, SECTION, **options))


def test_folders_files_and_modules_exist():
    for path in re.findall(r"`((?:torchbeam|tests|docs)/[\w/.]+)`", PAGE):
        assert (ROOT / path).exists(), path
    folders = {
        str(path.parent.relative_to(ROOT)) + "/"
        for path in (ROOT / "torchbeam/engine").glob("*/__init__.py")
    }
    assert folders == {name for name in re.findall(r"`(torchbeam/engine/\w+/)`", PAGE)}


def test_variables_are_read(monkeypatch, tmp_path):
    assert f"`{VARIABLE}`" in PAGE and all(f"`{engine}`" in PAGE for engine in ENGINES)
    monkeypatch.setenv("TORCHBEAM_CACHE", str(tmp_path))
    assert default_folder() == tmp_path
    monkeypatch.delenv("TORCHBEAM_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_folder() == tmp_path / "torchbeam"


def test_what_is_not_taken_is_refused():
    pytest.importorskip("llvmlite")
    assert "Whatever else is refused by name and line" in PAGE

    def branches(r, R, v, w, t):
        return (v if v.sum() > 0 else -v), None

    with pytest.raises(ValueError, match="engine = 'compiled' was given"):
        tb.Stepper(tb.Scene(scene().beam, [tb.Load(branches, node=-1)]), 0.01, engine="compiled")


def test_forward_mode_is_made_eagerly_with_the_same_result():
    pytest.importorskip("llvmlite")
    found = []
    for engine in ("eager", "compiled"):
        stepper = tb.Stepper(scene(), 0.01, engine=engine)
        start = stepper.rest()
        away = (start.position[:, :1] > 0).to(start.velocity)  # from the clamp, which rests

        def tip(velocity, stepper=stepper, start=start, away=away):
            return stepper(replace(start, velocity=away * velocity)).tip.position

        found.append(torch.func.jvp(tip, (torch.zeros(3),), (torch.ones(3),))[1])
    assert torch.equal(*found) and found[0].abs().max() > 0


def test_the_growth_that_is_let_pass_is_stated():
    assert f"more than {100 * GROWTH:.0f} %" in PAGE
