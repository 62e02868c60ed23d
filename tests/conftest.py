"""What every test shares: float64, one thread (or OMP_NUM_THREADS), and the reference cases."""

import json
import os
import sys
from importlib import resources
from pathlib import Path

import pytest
import torch

# what "auto" means here, unless it is said: hundreds of scenes are not compiled for one step each
os.environ.setdefault("TORCHBEAM_ENGINE", "eager")

sys.path.insert(0, str(Path(__file__).parent / "cases"))  # what several tests draw on: nodal_cases, mixed_cases, gradient_cases

THREADS = int(os.environ.get("OMP_NUM_THREADS", 1))
torch.set_default_dtype(torch.float64)


torch.set_num_threads(THREADS)


@pytest.fixture(autouse=True)
def double_precision_on_given_threads():
    """A test that changes the default dtype or the number of threads does not reach the next."""
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(THREADS)
    yield
    torch.set_default_dtype(torch.float64)


@pytest.fixture(scope="session")
def reference():
    """reference("heavy_elastica") -> torchbeam/data/heavy_elastica.json, the file that the package's own studies read"""
    return lambda name: json.loads(resources.files("torchbeam").joinpath(f"data/{name}.json").read_text())
