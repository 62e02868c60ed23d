"""docs/control_libraries.md and docs/uq_libraries.md: each block behind the first one, where its
library is installed, and the numbers that it prints.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = [(DOCS / f"{name}_libraries.md").read_text() for name in ("control", "uq")]
FIRST, BLOCKS = {}, {}  # by library
for page in PAGES:
    first, *blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names = re.findall(r"^## (\S+)", page, re.MULTILINE)
    FIRST |= dict.fromkeys(names, first)
    BLOCKS |= dict(zip(names, blocks, strict=True))
FIRST["do-mpc"] += "import casadi\n"


def numbers(library: str, module: str, folder: Path) -> list[float]:
    """That its block prints, run as pasted, in a process of its own."""
    pytest.importorskip(module)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FIRST[library] + BLOCKS[library]],
        cwd=folder, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    printed = re.sub(r"^\*.*|^.*IPOPT.*", "", done.stdout, flags=re.MULTILINE)
    return [float(x) for x in re.findall(r"(?<![\w.])-?\d+\.?\d*(?![\w])", printed)]


def test_python_control(tmp_path):
    """LQR of the linear model leaves a hundredth of what the full beam swings by itself."""
    free, still_free, start, left = numbers("python-control", "control", tmp_path)
    assert free == start > 0.11 and still_free > 0.1 and left < 0.01 * still_free


def test_casadi(tmp_path):
    """Gauss-Newton steps, a few, to within 2 mm of what is asked for."""
    iterations, *tips = numbers("CasADi", "casadi", tmp_path)
    assert iterations <= 5 and len(tips) == 5 and all(abs(tip - 0.1) < 2.5e-3 for tip in tips)


def test_do_mpc(tmp_path):
    """To what the linear model takes for 0.1 m."""
    *_, tip = numbers("do-mpc", "do_mpc", tmp_path)
    assert 0.1 < tip < 0.103


def test_openturns(tmp_path):
    """FORM by our gradients, and samples, agree on a rare deflection."""
    limit, form, samples = numbers("OpenTURNS", "openturns", tmp_path)
    assert limit == 0.27 and abs(form - samples) < 4 * (0.034 / 20000) ** 0.5


@pytest.mark.long
def test_pymc(tmp_path):
    """The posterior of E covers the true 66 GPa."""
    mean, deviation = numbers("PyMC", "pymc", tmp_path)
    assert abs(mean - 66.0) < 3 * deviation < 1.5


def test_every_library_has_its_block():
    assert list(BLOCKS) == ["python-control", "CasADi", "do-mpc", "OpenTURNS", "PyMC"]
