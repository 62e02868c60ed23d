"""What every test shares: float64, one thread (or OMP_NUM_THREADS), and the reference cases."""

import json
import os
from importlib import resources
from pathlib import Path
from unittest.mock import patch

import pytest
import torch

from torchbeam.engine import engine_use

THREADS = int(os.environ.get("OMP_NUM_THREADS", 1))
torch.set_default_dtype(torch.float64)


torch.set_num_threads(THREADS)


UNIT, ENGINE = Path(__file__).parent / "unit", "TORCHBEAM_ENGINE"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Tests run by the engine that users have. Unit tests, hundreds of scenes that make a step or
    two each, do so eagerly, as compiling a structure takes a second, unless they are marked "steps"
    or the environment says otherwise.
    """
    with patch.dict(os.environ):  # what a test leaves there does not reach the next
        if UNIT in item.path.parents and not item.get_closest_marker("steps"):
            os.environ.setdefault(ENGINE, "eager")
        return (yield)


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
    """reference("heavy_elastica") -> torchbeam/data/heavy_elastica.json, the file that the
    package's own studies read
    """
    return lambda name: json.loads(
        resources.files("torchbeam").joinpath(f"data/{name}.json").read_text()
    )
