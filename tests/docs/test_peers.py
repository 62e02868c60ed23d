"""examples/peers: other programs in the common dynamic case, where they are installed; each has the
error that is stated.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from torchbeam.studies.uncertainty.scale import FUNCTIONS

PEERS = Path(__file__).parents[2] / "examples" / "peers"


def printed(script, *options):
    """The rows of a quick run."""
    done = subprocess.run(
        [sys.executable, str(PEERS / f"{script}.py"), "--json", "--quick", *options],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        timeout=120,
    )
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


@pytest.mark.parametrize(
    "script, package, error", [("mujoco_rod", "mujoco", 0.0083), ("exudyn_plane", "exudyn", 0.0067)]
)
def test_peer(script, package, error):
    """The error to a tenth: it hangs on the program's version a little."""
    pytest.importorskip(package)
    row = printed(script)[0]
    assert abs(row["error"] - error) < 0.1 * error and row["rate"] > 1


def test_samples():
    """With --samples: exudyn's strip bends and swings as that of `python -m torchbeam scale` does
    at the means, to 1 %.
    """
    pytest.importorskip("exudyn")
    rows = {row["what"]: row for row in printed("exudyn_plane", "--samples")}
    one = torch.ones(1, dtype=torch.float64)
    for what, function in FUNCTIONS.items():
        assert rows[what]["failed"] == 0 and rows[what]["at_means"] == pytest.approx(
            function(one, one)[0].item(), rel=0.01
        )


@pytest.mark.parametrize(
    "script, package, error",
    [
        ("exudyn_mechanisms", "exudyn", {"four-bar": 0.0007, "hand": 0.0019}),
        ("mujoco_mechanisms", "mujoco", {"four-bar": 0.0029, "hand": 0.0029}),
    ],
)
def test_mechanisms(script, package, error):
    """Of a linkage and a hand, as `test_peer`: three programs agree on the reference."""
    pytest.importorskip(package)
    rows = {row["what"]: row for row in reversed(printed(f"mechanisms/{script}"))}
    for name, stated in error.items():
        assert abs(rows[name]["error"] - stated) < 0.1 * stated


def test_readme_lists_every_script():
    text = (PEERS.parent / "README.md").read_text()
    paths = [*PEERS.glob("*.py"), *PEERS.glob("mechanisms/*.py")]
    assert [p for p in paths if f"`{p.relative_to(PEERS.parent)}`" not in text] == []
