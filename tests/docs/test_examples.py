"""Every example, imported as a user would run it: its check number is what it says
(see examples/README.md).
"""

import sys
from pathlib import Path

import pytest
import torch

from tests.cases.modules import module_of
from torchbeam.engine import engine_use

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))
# packages that an example is about, and the least version
EXTRA = {"identify_nuts": ("pyro",), "identify_scipy": ("scipy",), "mujoco_mast": ("mujoco", "4")}
LONG = {"identify_accelerometers", "identify_field", "identify_nuts", "knot", "rope_pile"}


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, id=p.stem, marks=[pytest.mark.long] * (p.stem in LONG)) for p in EXAMPLES],
)
def test_example(path, tmp_path, monkeypatch):
    """In PyTorch's own default dtype. CHECK within TOLERANCE of EXPECTED; importing draws nothing,
    writes nothing and needs no matplotlib.
    """
    if path.stem in EXTRA:
        pytest.importorskip(*EXTRA[path.stem])
    torch.set_default_dtype(torch.float32)
    monkeypatch.chdir(tmp_path)
    # one eager step of what "auto" does not take is a warning, and an error
    monkeypatch.setattr(engine_use, "SOLVES", 1)
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # importing it would raise
    example = module_of(path)
    assert abs(example.CHECK - example.EXPECTED) <= example.TOLERANCE
    assert not list(tmp_path.iterdir())


def test_readme_lists_every_example():
    text = (EXAMPLES[0].parent / "README.md").read_text()
    assert [p.name for p in EXAMPLES if f"`{p.name}`" not in text] == []
