"""What every test shares: float64, one thread (or OMP_NUM_THREADS), and the reference cases."""

import gc
import json
import os
from collections import Counter
from contextlib import nullcontext
from importlib import resources
from pathlib import Path
from unittest.mock import patch
from zlib import crc32

import pytest
import torch

from torchbeam.core import remembered
from torchbeam.engine import engine_use
from torchbeam.engine.compiler import library

THREADS = int(os.environ.get("OMP_NUM_THREADS", 1))
torch.set_default_dtype(torch.float64)


torch.set_num_threads(THREADS)


pytest_plugins = ["tests.costs"]
HERE, ENGINE = Path(__file__).parent, "TORCHBEAM_ENGINE"
IN_TURN = set(json.loads((HERE / "in_turn.json").read_text()))
EAGER = {HERE / "unit", HERE / "studies"}
# What is compiled as users have it: the compiler's own tests, both engines over random scenes, and
# the verification. All else is made at LLVM's level 0, for a quarter of the time.
OPTIMISED = {
    HERE / "unit/engine/compiler", HERE / "properties/test_engine_fuzz.py", HERE / "verification",
}  # fmt: skip


def pytest_addoption(parser):
    parser.addoption("--share", help="K/N: of the chosen tests each N-th, from the K-th (1 to N)")
    parser.addoption("--turn", default="1/1", help="K/N: the same of each test in in_turn.json")
    parser.addoption("--eager", metavar="FOLDER", help="whose tests step eagerly, as units do")


def pytest_report_header(config):
    return f"rows of tests of in_turn.json: {config.getoption('--turn')} of them (--turn, TURN)"


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """A share of long nets: the N shares together are the whole, each goes through all kinds. Of
    what is in in_turn.json, one claim over many scenes or a dear test, N turns together run all.
    """
    k, n = map(int, config.getoption("--turn").split("/"))
    place, waiting = Counter(), set()
    for item in items:
        test = item.nodeid.partition("[")[0]
        if test in IN_TURN and not item.get_closest_marker("always"):
            start = crc32(test.partition("::")[0].encode())  # a file's dear tests share fixtures
            waiting |= {item.nodeid} if (start + place[test]) % n != k - 1 else set()
            place[test] += 1
    if share := config.getoption("--share"):
        k, n = map(int, share.split("/"))
        waiting |= {x.nodeid for i, x in enumerate(items) if i % n != k - 1}
    config.hook.pytest_deselected(items=[x for x in items if x.nodeid in waiting])
    items[:] = [x for x in items if x.nodeid not in waiting]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Tests run by the engine that users have. Unit tests, hundreds of scenes that make a step or
    two each, do so eagerly, as compiling a structure takes a second, unless they are marked "steps"
    or the environment says otherwise.
    """
    with patch.dict(os.environ):  # what a test leaves there does not reach the next
        folder = item.config.getoption("--eager")
        eager = EAGER | ({Path(folder).absolute()} if folder else set())
        if eager & {*item.path.parents} and not item.get_closest_marker("steps"):
            os.environ.setdefault(ENGINE, "eager")
        with nullcontext() if OPTIMISED & {item.path, *item.path.parents} else QUICKLY:
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


def quickly():
    """A machine whose code is made four times as fast, and runs slower. Numbers are rounded alike
    one by one and in vectors, as by users' code: both are selected in the same manner.
    """
    binding, (_, processor, features) = library._binding(), HOST()
    binding.set_option("", "-fast-isel=false")
    return binding.Target.from_default_triple().create_target_machine(
        cpu=processor, features=features, opt=0, codemodel="jitdefault", jit=True
    )


HOST = library._host  # what objects on disk are told apart by, and their level
QUICKLY = patch.multiple(library, _machine=quickly, _host=lambda: (*HOST(), "quickly"))


@pytest.fixture(autouse=True)
def double_precision_on_given_threads():
    """A test that changes the default dtype or the number of threads, steps eagerly, or asks what
    is remembered, does not reach the next.
    """
    engine_use._of_short_runs.clear()
    remembered._VALUES.clear()
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
