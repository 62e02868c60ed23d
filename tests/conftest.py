"""What every test shares: float64, one thread, and the reference cases."""

import json
import sys
from pathlib import Path

import pytest
import torch

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))  # the helpers beside the tests: mixed_cases, nodal_cases

torch.set_default_dtype(torch.float64)
torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def double_precision_on_one_thread():
    """A test that changes the default dtype or the number of threads does not reach the next."""
    torch.set_default_dtype(torch.float64)
    torch.set_num_threads(1)
    yield
    torch.set_default_dtype(torch.float64)


@pytest.fixture(scope="session")
def reference():
    """reference("heavy_elastica") -> tests/reference/heavy_elastica.json"""
    return lambda name: json.loads((HERE / "reference" / f"{name}.json").read_text())
