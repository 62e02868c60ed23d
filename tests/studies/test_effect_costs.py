"""python -m studies effects: its files, and that its numbers are those of the scene."""

import json

import pytest
import torch

from studies.effect_costs import main, scene, table
from torchbeam.dynamics.stepper import Stepper
from torchbeam.nodal.discretise import discretise


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("effects")
    assert main(["--quick", "--out", str(out)]) == 0
    return out


def test_files(written):
    """Three files with every row of the table; what did not run says why."""
    rows = json.loads((written / "effects.json").read_text())["rows"]
    names = [name for name, *_ in table(4)]
    assert [r["effect"] for r in rows] == names
    assert len((written / "effects.csv").read_text().splitlines()) == len(names) + 1
    assert all(f"| {name} |" in (written / "effects.md").read_text() for name in names)
    for r in rows:
        assert r["note"] or (r["change"] >= 0 and all(v > 0 for v in r["time"].values()))


def test_numbers(written):
    """Weight against no weight, stepped here: the change is the tip's; a mass on the tip adds no
    operation; a plane takes some away and changes nothing but rounding.
    """
    of = {r["effect"]: r for r in json.loads((written / "effects.json").read_text())["rows"]}
    paths = []
    for made in (scene(4), next(make for name, _, make in table(4) if name == "Gravity")()):
        stepper = Stepper(made, 0.005)
        states = [stepper.rest()]
        for _ in range(4):
            states.append(stepper(states[-1]))
        paths.append(torch.stack([s.tip.position for s in states]))
    moved = (paths[1] - paths[0]).square().mean() / (paths[0] - paths[0][0]).square().mean()
    assert of["Gravity"]["change"] == pytest.approx(moved.sqrt().item(), rel=1e-9)
    assert of["PointMass"]["operations"] == 0 < of["Gravity"]["operations"]
    assert of["plane"]["operations"] < 0 and of["plane"]["change"] < 1e-10


def test_every_row_is_taken():
    refused = []
    for name, _, make in table(4):
        try:
            discretise(make())
        except ValueError:
            refused.append(name)
    assert not refused
