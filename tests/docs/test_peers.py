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

from studies import peers
from studies.uncertainty.scale import FUNCTIONS

PEERS = Path(__file__).parents[2] / "examples" / "peers"


def printed(script, *options):
    """The rows of a quick run."""
    done = subprocess.run(
        [sys.executable, str(PEERS / f"{script}.py"), "--json", "--quick", *options],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


@pytest.mark.parametrize(
    "script, package, error",
    [
        ("mujoco_rod", "mujoco", 0.0083),
        ("exudyn_plane", "exudyn", 0.0067),
        ("soromox_rod", "soromox", 0.0111),
        ("dismech_newton_rod", "newton", 0.0116),
    ],
)
def test_peer(script, package, error):
    """The error to a tenth: it hangs on the program's version a little."""
    pytest.importorskip(package)
    row = printed(script)[0]
    assert abs(row["error"] - error) < 0.1 * error and row["rate"] > 1


def test_samples():
    """With --samples: exudyn's strip bends and swings as that of `python -m studies scale` does
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


FAKE = """
from pathlib import Path
if __name__ == "__main__":
    Path(__file__).with_suffix(".ran").open("a").write("x")
    print('{"peer": "other 1.0", "space": "3D", "elements": 7, "element": "rod", "step_ms": 1.0, '
          '"error": 0.02, "best_cpu_s": 1.0, "median_cpu_s": 1.0, "rate": 2.0, "batch": 1}')
"""


def test_one_run_of_all(tmp_path):
    """Each row of a program stands beside the fastest here of no larger error; --resume goes on
    behind what is there; a script that stops is left out.
    """
    folder, out = tmp_path / "peers", tmp_path / "out"
    folder.mkdir()
    (folder / "a.py").write_text(FAKE)
    (folder / "b.py").write_text("if __name__ == '__main__': raise SystemExit(3)")
    options = ["--quick", "--peers", str(folder), "--out", str(out)]
    peers.main(options)
    rows = json.loads((out / "peers.json").read_text())["rows"]
    own = [row for row in rows if row["peer"].startswith("torchbeam")]
    assert [row["script"] for row in rows] == ["a"] * len(rows) and len(own) == 6
    assert {(r["space"], r["batch"]) for r in own} == {("3D", 1), ("plane", 1), ("3D", peers.BATCH)}
    best = max((r for r in own if r["batch"] == 1 and r["space"] == "3D" and r["error"] < 0.02),
               key=lambda r: r["rate"])  # fmt: skip
    line = next(x for x in (out / "peers.md").read_text().splitlines() if "other 1.0" in x)
    assert line.endswith(f"| {100 * best['error']:.2g} % | {best['rate']:.3g} |")
    (folder / "b.py").write_text(FAKE.replace("other", "another"))
    peers.main([*options, "--resume"])
    rows = json.loads((out / "peers.json").read_text())["rows"]
    assert {row["script"] for row in rows} == {"a", "b"}
    assert (folder / "a.ran").read_text() == (folder / "b.ran").read_text() == "x"


def test_readme_lists_every_script():
    text = (PEERS.parent / "README.md").read_text()
    paths = [*PEERS.glob("*.py"), *PEERS.glob("mechanisms/*.py")]
    assert [p for p in paths if f"`{p.relative_to(PEERS.parent)}`" not in text] == []
