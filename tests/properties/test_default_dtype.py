"""Answers do not depend on torch's default dtype, which users have at float32 and these tests at
float64: of every good public call, and of a scene with each number of each effect and joint.
"""

import os
import subprocess
import sys

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from cases.rows import ENDS, JOINTS, ROWS, SECTION, double, joined
from tests.cases.answers import numbers

EPS = dict(rtol=1e-12, atol=1e-12)


@pytest.fixture(scope="module")
def by_default(tmp_path_factory):
    """Answers to every call in a process of each default."""
    found = {}
    for name in ("float64", "float32"):
        file = tmp_path_factory.mktemp("answers") / f"{name}.pt"
        subprocess.run(
            [sys.executable, "-m", "tests.cases.answers", name, str(file)],
            check=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )
        found[name] = torch.load(file)
    return found


def test_public_calls_answer_alike(by_default):
    """To 1e-12, and in double, where the arguments are numbers, lists or float64 tensors."""
    double, single = by_default.values()
    assert double.keys() == single.keys() and len(double) > 200
    for call, expected in double.items():
        assert isinstance(expected, dict), f"{call}: {expected}"
        assert expected.keys() == single[call].keys(), call
        for name, value in expected.items():
            found, said = single[call][name], f"{call} {name}: ".__add__
            assert_close(found, value, **EPS, equal_nan=True, msg=said)


def of_row(row, joint):
    """Numbers of a step."""
    if joint:
        value = double(row.value) if isinstance(row.value, tuple) else row.value
        scene = joined(row.make(value, *ENDS))
    else:
        beam = tb.Beam.straight(1.0, 2, SECTION)
        push = tb.TipLoad(force=(0.1, 0.2, 0.3))
        scene = tb.Scene(beam, [row.make(row.value, 2), push])
    return dict(numbers(tb.simulate(scene, [0.0, 0.01], step=0.01, engine="eager")))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", [*ROWS, *JOINTS])
def test_each_effect_and_joint_acts_alike(name):
    row = {**ROWS, **JOINTS}[name]
    expected = of_row(row, name in JOINTS)
    torch.set_default_dtype(torch.float32)
    found = of_row(row, name in JOINTS)
    assert found.keys() == expected.keys() and len(found) > 5
    for key, value in expected.items():
        assert_close(found[key], value, **EPS, equal_nan=True)
