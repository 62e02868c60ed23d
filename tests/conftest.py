"""What every test shares: float64, one thread (or OMP_NUM_THREADS), and the reference cases."""

import gc
import json
import os
from collections import Counter
from contextlib import nullcontext
from importlib import resources
from pathlib import Path
from unittest.mock import patch

import pytest
import torch

from torchbeam.engine import engine_use
from torchbeam.engine.compiler import library

THREADS = int(os.environ.get("OMP_NUM_THREADS", 1))
torch.set_default_dtype(torch.float64)


torch.set_num_threads(THREADS)


HERE, ENGINE = Path(__file__).parent, "TORCHBEAM_ENGINE"
EAGER = {HERE / "unit", HERE / "studies"}
# Files of many structures and few steps: native code is made at LLVM's level 0, for a third of the
# time. Not for equality to the bit: there samples alone and in vectors are rounded differently.
CHAIN = "adjoint cells disk_key loads_between native_tendons robustness structures touching"
QUICK = {HERE / f"unit/engine/chain/test_{name}.py" for name in CHAIN.split()} | {
    HERE / "docs/test_examples.py", HERE / "docs/test_pages.py",
    HERE / "properties/test_parity.py", HERE / "properties/test_value_forms.py",
    HERE / "properties/test_written_tensors.py", HERE / "properties/test_second_derivatives.py",
    HERE / "unit/core/test_entry_point.py", HERE / "unit/dynamics/test_order_and_error.py",
    HERE / "unit/dynamics/test_prepared.py",
    HERE / "unit/analysis/estimation/test_kalman_filter.py",
}  # fmt: skip


def pytest_addoption(parser):
    parser.addoption("--share", help="K/N: of the chosen tests each N-th, from the K-th (1 to N)")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """A share of long nets: the N shares together are the whole, each goes through all kinds."""
    if share := config.getoption("--share"):
        k, n = map(int, share.split("/"))
        config.hook.pytest_deselected(items=[x for i, x in enumerate(items) if i % n != k - 1])
        items[:] = items[k - 1 :: n]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Tests run by the engine that users have. Unit tests, hundreds of scenes that make a step or
    two each, do so eagerly, as compiling a structure takes a second, unless they are marked "steps"
    or the environment says otherwise.
    """
    with patch.dict(os.environ):  # what a test leaves there does not reach the next
        if EAGER & {*item.path.parents} and not item.get_closest_marker("steps"):
            os.environ.setdefault(ENGINE, "eager")
        with QUICKLY if item.path in QUICK else nullcontext():
            return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Thousands of tests that stay until the end: looking for garbage among them takes seconds."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(20_000)
        gc.enable()


def cpu_seconds():
    """Of this process and of those that it has waited for."""
    return sum(os.times()[:4])


SPENT = Counter(cpu=cpu_seconds(), compiled=0)  # by this process up to the last report
COSTS, DEAREST = {}, 15  # of test files, by their reports; how many are shown


def counted(make):
    """Compiles, and counts it."""

    def compiled(*args):
        SPENT["compiled"] += 1
        return make(*args)

    return compiled


def quickly():
    """A machine whose code is made three times as fast, and runs slower."""
    binding, (_, processor, features) = library._binding(), HOST()
    return binding.Target.from_default_triple().create_target_machine(
        cpu=processor, features=features, opt=0, codemodel="jitdefault", jit=True
    )


HOST = library._host  # what objects on disk are told apart by, and their level
QUICKLY = patch.multiple(library, _machine=quickly, _host=lambda: (*HOST(), "quickly"))
library._object = counted(library._object)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    """What a phase of a test cost, in its report, which other processes send to the first."""
    report, now = (yield), cpu_seconds()
    report.cpu, report.compiled = now - SPENT["cpu"], SPENT.pop("compiled", 0)
    SPENT["cpu"] = now
    return report


def pytest_runtest_logreport(report):
    COSTS.setdefault(report.nodeid.partition("::")[0], Counter()).update(
        cpu=report.cpu, compiled=report.compiled, tests=report.when == "call"
    )


def pytest_terminal_summary(terminalreporter):
    """The dearest files, by CPU seconds, which other work on the machine changes little; programs
    that were found on disk are not compiled.
    """
    total = sum(COSTS.values(), Counter())
    if total["cpu"] < 60:
        return
    terminalreporter.section("dearest test files")
    files = sorted(COSTS.items(), key=lambda row: -row[1]["cpu"])[:DEAREST]
    for name, cost in [*files, ("all, without collecting them", total)]:
        counts = f"{cost['compiled']:5} compiled {cost['tests']:5} tests"
        terminalreporter.line(f"{cost['cpu']:8.1f} CPU s {counts}  {name}")


@pytest.fixture(autouse=True)
def double_precision_on_given_threads():
    """A test that changes the default dtype or the number of threads, or steps eagerly, does not
    reach the next.
    """
    engine_use._of_short_runs.clear()
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(THREADS)
    yield
    torch.set_default_dtype(torch.float64)


@pytest.fixture(scope="session")
def reference():
    """reference("heavy_elastica") -> studies/data/heavy_elastica.json, the file that the
    studies read
    """
    return lambda name: json.loads(
        resources.files("studies").joinpath(f"data/{name}.json").read_text()
    )
