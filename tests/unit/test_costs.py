"""Costs of tests, by file and folder, beside their bounds."""

import json
from collections import Counter
from types import SimpleNamespace

from tests import conftest, costs

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


def test_a_unit_that_takes_long_is_named(monkeypatch):
    """After any run, however short; what is no unit may take longer."""
    for name in ("LONG", "FILES", "TESTS"):
        monkeypatch.setattr(costs, name, {})
    for file, cpu in (("unit/a.py", 21.0), ("unit/b.py", 19.0), ("verification/c.py", 99.0)):
        nodeid = f"tests/{file}::test[x]"
        costs.pytest_runtest_logreport(
            SimpleNamespace(nodeid=nodeid, cpu=cpu, compiled=0, when="call")
        )
    lines, short = [], Counter(cpu=1.0)
    monkeypatch.setattr(costs, "FILES", {"tests/unit/a.py": short})
    costs.pytest_terminal_summary(SimpleNamespace(line=lambda x, **_: lines.append(x)))
    (line,) = lines
    assert line.startswith("tests/unit/a.py::test[x] took 21 CPU s, and 20 is the bound of a unit")


def test_what_runs_in_turn_is_there():
    for test in conftest.IN_TURN:
        file, _, name = test.partition("::")
        assert f"def {name}(" in (costs.HERE.parent / file).read_text(), test


def test_turns_together_run_each_row_once_and_what_is_to_run_always_in_each():
    test, others = sorted(conftest.IN_TURN)[0], ["tests/a.py::test_b[1]", "tests/a.py::test_c"]
    names = [*(f"{test}[{k}]" for k in range(8)), f"{test}[always]", *others]

    def item(name):
        return SimpleNamespace(
            nodeid=name, get_closest_marker=lambda mark: mark == "always" and mark in name
        )

    def ran(turn):
        items = [item(name) for name in names]
        hook = SimpleNamespace(pytest_deselected=lambda items: None)
        options = {"--turn": turn, "--share": None}
        config = SimpleNamespace(getoption=options.get, hook=hook)
        conftest.pytest_collection_modifyitems(config, items)
        return [x.nodeid for x in items]

    turns = [ran(f"{k}/3") for k in (1, 2, 3)]
    assert ran("1/1") == names and {len(turn) for turn in turns} == {5, 6}
    assert all({names[8], *others} < {*turn} for turn in turns)
    assert Counter(name for turn in turns for name in turn) == Counter(
        names + 2 * [names[8], *others]
    )
