"""docs/works_with.md: each block trains a few thousand frames by its library, where that is
installed.
"""

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "works_with.md").read_text()
BLOCKS = dict(re.findall(r"^## (\w[\w-]*).*?```python\n(.*?)```", PAGE, re.DOTALL | re.MULTILINE))


@pytest.mark.parametrize(
    "library, module",
    [
        ("stable-baselines3", "stable_baselines3"),
        ("skrl", "skrl"),
        ("torchrl", "torchrl"),
        ("RLlib", "ray.rllib"),
    ],
)
def test_the_block_in_the_docs_trains(library, module, tmp_path):
    """In its own process, as pasted. The returns it prints are finite, and the last is better than
    the first.
    """
    pytest.importorskip(module)
    # training is not installed
    places = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-c", BLOCKS[library]], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": places, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    returns = [float(value) for value in re.findall(r"^return (\S+)$", done.stdout, re.MULTILINE)]
    assert len(returns) >= 4 and all(map(math.isfinite, returns)), done.stdout
    assert returns[-1] > returns[0]
    assert not list(tmp_path.iterdir())  # nothing left behind


def test_every_library_has_its_block():
    assert set(BLOCKS) == {"stable-baselines3", "skrl", "torchrl", "RLlib"}
