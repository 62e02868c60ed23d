"""What tests cost, in CPU seconds, which other work on the machine changes little: the dearest
files at the end of a run; all of them, each by its last run of many, in `out/test_costs.json`; and
a sentence for each unit that took more than `MOST`, and for each folder that took more than
`cost_bounds.json` says. A plugin of `conftest.py`; no test fails by it.

After a change that is meant: `.ci/run`, then `python -m tests.costs` makes the bounds anew, and
adds to `in_turn.json` what is dear: one claim over many scenes, of which each turn runs some, or
what takes seconds by itself.
"""

import json
import math
import os
from collections import Counter
from pathlib import Path

import pytest

from torchbeam.engine.compiler import library

HERE = Path(__file__).parent
BOUNDS, COSTS = HERE / "cost_bounds.json", HERE.parent / "out" / "test_costs.json"
DEAREST = 15  # files that are shown
LEAST = 60.0  # CPU seconds of a run that is told of
MOST = 20.0  # CPU seconds of a unit: units step eagerly, where a long motion takes minutes
IN_TURN = HERE / "in_turn.json"
DEAR, ALONE, ROWS = 1.2, 2.5, 3  # CPU seconds of so many rows together, or of fewer
ROOM = 1.3  # by which a bound is more than what was measured, for another processor


def cpu_seconds():
    """Of this process and of those that it has waited for."""
    return sum(os.times()[:4])


SPENT = Counter(cpu=cpu_seconds(), compiled=0)  # by this process up to the last report
FILES, TESTS, PROCESSES = {}, {}, []  # costs by reports; CPU seconds of whole processes
LONG = {}  # CPU seconds of units beyond their bound


def counted(make):
    """Compiles, and counts it."""

    def compiled(*args):
        SPENT["compiled"] += 1
        return make(*args)

    return compiled


library._object = counted(library._object)


def pytest_collection_finish():
    SPENT["cpu"] = cpu_seconds()  # what came before the first test is none's


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """What a phase of a test cost, in its report, which other processes send to the first."""
    report, now = (yield), cpu_seconds()
    report.cpu, report.compiled = now - SPENT["cpu"], SPENT.pop("compiled", 0)
    SPENT["cpu"] = now
    return report


def pytest_runtest_logreport(report):
    cost = dict(cpu=report.cpu, compiled=report.compiled, tests=report.when == "call")
    for sums, end in ((FILES, "::"), (TESTS, "[")):
        sums.setdefault(report.nodeid.partition(end)[0], Counter()).update(cost)
    if report.cpu > MOST and report.nodeid.startswith("tests/unit/"):
        LONG[report.nodeid] = report.cpu


@pytest.hookimpl(tryfirst=True)
def pytest_sessionfinish(session):
    """A process of xdist says what it took; the first has run no test where there are such."""
    if (output := getattr(session.config, "workeroutput", None)) is not None:
        output["cpu"] = cpu_seconds()
    elif not session.config.getoption("numprocesses", None):
        PROCESSES.append(cpu_seconds())


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    PROCESSES.append(getattr(node, "workeroutput", {}).get("cpu", 0.0))


def by_folder(files):
    """Costs by folder, the dearest first; of the units by the folders below."""
    sums = {}
    for name, cost in files.items():
        *parts, _ = Path(name).parts
        sums.setdefault("/".join(parts[: 3 if "unit" in parts else 2]), Counter()).update(cost)
    return dict(sorted(sums.items(), key=lambda row: -row[1]["cpu"]))


def beyond(bounds, folders):
    """A sentence for each folder that took more than its bound."""
    return [
        f"{name} took {folders[name]['cpu']:.0f} CPU s, and {bound} is its bound"
        for name, bound in bounds.items()
        if name in folders and folders[name]["cpu"] > bound
    ]


def with_others(found, kind="files"):
    """Beside them what the stored runs say of files that did not run now, and are still there."""
    stored = json.loads(COSTS.read_text()).get(kind, {}) if COSTS.exists() else {}
    ran = {name.partition("::")[0] for name in found}
    others = {
        name: Counter(cost)
        for name, cost in stored.items()
        for file in [name.partition("::")[0]]
        if file not in ran and (HERE.parent / file).exists()
    }
    return dict(sorted({**found, **others}.items(), key=lambda row: -row[1]["cpu"]))


def pytest_terminal_summary(terminalreporter):
    """Programs that were found on disk are not compiled."""
    for name, cpu in LONG.items():
        sentence = f"{name} took {cpu:.0f} CPU s, and {MOST:.0f} is the bound of a unit"
        terminalreporter.line(f"{sentence}: fewer steps, or native ones (steps)", yellow=True)
    total = sum(FILES.values(), Counter())
    if total["cpu"] < LEAST:
        return
    beside = max(0.0, sum(PROCESSES) - total["cpu"])
    files = with_others(FILES)
    folders = by_folder(files) | {"all": sum(files.values(), Counter())}
    COSTS.parent.mkdir(exist_ok=True)
    stored = {"folders": folders, "files": files, "tests": with_others(TESTS, "tests")}
    COSTS.write_text(json.dumps(stored, indent=1) + "\n")

    terminalreporter.section(f"dearest test files; all of them: {COSTS.relative_to(HERE.parent)}")
    shown = sorted(FILES.items(), key=lambda row: -row[1]["cpu"])[:DEAREST]
    rows = [*shown, ("all of this run", total), ("imports and collection", Counter(cpu=beside))]
    for name, cost in rows:
        counts = f"{cost['compiled']:5} compiled {cost['tests']:5} tests"
        terminalreporter.line(f"{cost['cpu']:8.1f} CPU s {counts}  {name}")
    for sentence in beyond(json.loads(BOUNDS.read_text()), folders):
        terminalreporter.line(f"dearer than it was: {sentence}", yellow=True)


if __name__ == "__main__":
    found = json.loads(COSTS.read_text())
    bounds = {k: 5 * math.ceil(ROOM * cost["cpu"] / 5) for k, cost in found["folders"].items()}
    least = {True: DEAR, False: ALONE}
    dear = {k for k, x in found["tests"].items() if x["cpu"] >= least[x["tests"] >= ROWS]}
    dear |= set(json.loads(IN_TURN.read_text()))
    BOUNDS.write_text(json.dumps(bounds, indent=1) + "\n")
    IN_TURN.write_text(json.dumps(sorted(dear), indent=1) + "\n")
