"""What only a process of its own shows, in one: what importing torchbeam, and using it, imports (no
extra and no computer algebra before they are needed, which would take seconds); hashes of texts;
threads that a user sets.
"""

import os
import subprocess
import sys
from collections import namedtuple

import pytest
import torch

import torchbeam as tb
from tests.unit.core.test_digests import digests, function

IN_SET = "def f(x):\n    return x in {'a', 'b', 'c', 'd', 'e', 'f', 'g', 'h'}"
CODES = {  # one after the other; each prints its name at its end
    "mixed forms": """
import os, sys, torch, torchbeam as tb
section = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=1.0, mass=1.0, inertia=0.01)
scene, file = tb.Scene(tb.Beam.straight(1.0, 2, section)), os.environ["MIXED_STATE"]
solution = tb.simulate(scene, [0.0, 0.01], step=0.01, engine="eager")
assert tb.load(tb.save(solution, file + ".run", scene=scene), scene=scene).status == 0
assert not any(name.startswith("torchbeam.mixed") for name in sys.modules)
for _ in range(2):
    assert type(torch.load(file, weights_only=True)) is tb.MixedState
""",
    "library": """
import sys, torchbeam as tb
section = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=1.0, mass=1.0, inertia=0.01)
scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [tb.Gravity((0, 0, -9.81))])
assert "matplotlib" not in sys.modules
tb.Stepper(scene, 0.01)  # by native code, once it steps
tb.describe(scene)
assert "llvmlite" not in sys.modules
tb.Stepper(scene, 0.01, engine="eager")(tb.rest(scene))
assert not {"sympy", "torchdiffeq", "scipy", "torchbeam.cross_section.public"} & set(sys.modules)
pull = tb.Load(lambda p, R, v, w, t: (-p, None), node=-1)
sprung = tb.Scene(tb.Beam.straight(1.0, 1, section), [tb.Spring(-1, 3.0), pull], plane="xz")
tb.Stepper(sprung, 0.01, engine="eager")(tb.rest(sprung))
tb.Stepper(sprung, 0.01, engine="compiled")  # traced; torch's compiler would take two seconds
assert not {"sympy", "torch._dynamo"} & set(sys.modules)
""",
    "environments": """
import torchbeam_envs
assert not {"stable_baselines3", "pygame", "matplotlib"} & set(sys.modules)
torchbeam_envs.TipReachVectorEnv(2, elements=2)
assert not {"sympy", "torchdiffeq", "scipy"} & set(sys.modules)
try:
    torchbeam_envs.Sb3VecEnv
except ImportError as error:
    assert "torchbeam[rl]" in str(error)
else:
    assert "stable_baselines3" in sys.modules
""",
    "digests": f"""
{IN_SET}
from torchbeam.core.function_dependencies import Dependencies
print(Dependencies([("", lambda: f)]).digests())
""",
    "dense systems": """
import torch
from torchbeam.math.dense import inverse_unchecked, solve, solve_unchecked
torch.manual_seed(0)
torch.set_num_threads(2)
A, x = (torch.randn(4, 200, n, dtype=torch.float64) for n in (200, 3))
found = (inverse_unchecked(A) @ (A @ x), solve(A, A @ x), solve_unchecked(A, A @ x))
assert all((y - x).abs().max() < 1e-9 for y in found)
""",
    "search": """
torch.set_default_dtype(torch.float64)
torch.manual_seed(0)
X = torch.randn(200, 160) / 12
start = torch.full((160,), 2.0)
fit = tb.identify(lambda theta: theta @ X.mT, X.sum(-1), start, starts=3, derivatives="difference")
assert fit.status == 0 and (fit.theta - 1).abs().max() < 1e-6
""",
}
OTHER = {"PYTHONHASHSEED": "1", "OMP_NUM_THREADS": "2", "OMP_WAIT_POLICY": "PASSIVE"}
Done = namedtuple("Done", "status printed said")


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Names and lines that it printed, and what it said of an error."""
    file = tmp_path_factory.mktemp("mixed") / "state.pt"
    section = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=1.0, mass=1.0, inertia=0.01)
    torch.save(tb.consistent_state(tb.Scene(tb.Beam.straight(1.0, 2, section))), file)
    code = "\n".join(f"{code}\nprint({name!r}, flush=True)" for name, code in CODES.items())
    env = {name: value for name, value in os.environ.items() if name != "TORCHBEAM_ENGINE"}
    env["MIXED_STATE"] = str(file)
    ran = subprocess.run(
        [sys.executable, "-c", code], env=env | OTHER, capture_output=True, text=True
    )
    return Done(ran.returncode, ran.stdout.splitlines(), ran.stderr)


@pytest.mark.parametrize("name", CODES)
def test_a_process_of_its_own(done, name):
    """mixed forms: a simulation, `save` and `load` import nothing of the derivation's element; a
    file with its state, read into a new process, does. library: importing it imports no
    matplotlib, a stepper and `describe` no llvmlite, a step no sympy and no torchdiffeq, with which
    scipy comes. environments: neither these nor pygame, nor stable-baselines3 before it is asked
    for.

    dense systems: torch's own LU of this batch is wrong on threads set by the user, or never ends
    (torch 2.13, MKL 2024.2). search: a linear model of 160 parameters, which are all 1, by
    differences; the same of three starts.
    """
    assert name in done.printed, done.said


def test_another_process_finds_the_same_digests(done):
    """Hashes of texts, and so the order of sets, are another process's own."""
    assert str(digests(function(IN_SET))) in done.printed
    assert done.status == 0, done.said
