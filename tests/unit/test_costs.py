"""Costs of tests, by folder, beside their bounds."""

import json
from collections import Counter
from pathlib import Path

from tests import costs

FILES = {
    "tests/unit/math/test_a.py": Counter(cpu=2.0, tests=3),
    "tests/unit/math/test_b.py": Counter(cpu=1.0, tests=1),
    "tests/unit/analysis/deeper/test_c.py": Counter(cpu=4.0, tests=1),
    "tests/unit/test_d.py": Counter(cpu=0.5, tests=1),
    "tests/docs/test_e.py": Counter(cpu=9.0, tests=1),
}


def test_costs_of_folders_beside_bounds():
    folders = costs.by_folder(FILES)
    wanted = {"tests/docs": 9, "tests/unit/analysis": 4, "tests/unit/math": 3, "tests/unit": 0.5}
    assert [*folders.items()] == [(k, Counter(cpu=x, tests=folders[k]["tests"])) for k, x in wanted.items()]
    assert folders["tests/unit/math"]["tests"] == 4
    bounds = {"tests/docs": 8, "tests/unit/math": 3, "tests/envs": 0}
    assert costs.beyond(bounds, folders) == ["tests/docs took 9 CPU s, and 8 is its bound"]


def test_every_folder_has_a_bound():
    root = Path(costs.HERE).parent
    files = (path.relative_to(root) for path in costs.HERE.rglob("test_*.py"))
    names = costs.by_folder({str(path): Counter() for path in files})
    assert {*names, "all"} <= {*json.loads(costs.BOUNDS.read_text())}
