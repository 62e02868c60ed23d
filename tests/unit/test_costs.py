"""Costs of tests, by file and folder, beside their bounds."""

import json
from collections import Counter

from tests import costs

FILES = {
    "tests/docs/test_e.py": Counter(cpu=9.0, tests=1),
    "tests/unit/analysis/deeper/test_c.py": Counter(cpu=4.0, tests=1),
    "tests/unit/math/test_a.py": Counter(cpu=2.0, tests=3),
    "tests/unit/math/test_b.py": Counter(cpu=1.0, tests=1),
    "tests/unit/test_costs.py": Counter(cpu=0.5, tests=1),
}


def test_costs_of_folders_beside_bounds():
    folders = costs.by_folder(FILES)
    wanted = {"tests/docs": 9, "tests/unit/analysis": 4, "tests/unit/math": 3, "tests/unit": 0.5}
    assert {name: cost["cpu"] for name, cost in folders.items()} == wanted
    assert folders["tests/unit/math"]["tests"] == 4
    bounds = {"tests/docs": 8, "tests/unit/math": 3, "tests/envs": 0}
    assert costs.beyond(bounds, folders) == ["tests/docs took 9 CPU s, and 8 is its bound"]
    assert json.loads(costs.BOUNDS.read_text())["all"] > 0


def test_a_run_of_some_files_keeps_what_is_known_of_others(tmp_path, monkeypatch):
    """Those that are gone, and those that ran now, are not taken from the stored runs."""
    monkeypatch.setattr(costs, "COSTS", tmp_path / "costs.json")
    (tmp_path / "costs.json").write_text(json.dumps({"files": FILES}))
    now = {"tests/conftest.py": Counter(cpu=1.0)}
    assert costs.with_others(now) == now | {"tests/unit/test_costs.py": Counter(cpu=0.5, tests=1)}
    again = {"tests/unit/test_costs.py": Counter(cpu=7.0)}
    assert costs.with_others(again) == again
