"""examples/peers: other programs in the common dynamic case, where they are installed; each has the error that is stated."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

PEERS = Path(__file__).parents[2] / "examples" / "peers"


@pytest.mark.parametrize("script, package, error", [("mujoco_rod", "mujoco", 0.0083), ("exudyn_plane", "exudyn", 0.0067)])
def test_peer(script, package, error):
    """The error to a tenth: it hangs on the program's version a little."""
    pytest.importorskip(package)
    done = subprocess.run([sys.executable, str(PEERS / f"{script}.py"), "--json", "--quick"], capture_output=True, text=True,
                          env={**os.environ, "OMP_NUM_THREADS": "1"}, timeout=120)
    row = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("{")))
    assert abs(row["error"] - error) < 0.1 * error and row["rate"] > 1


def test_readme_lists_every_script():
    text = (PEERS.parent / "README.md").read_text()
    assert [p.name for p in PEERS.glob("*.py") if f"`peers/{p.name}`" not in text] == []
