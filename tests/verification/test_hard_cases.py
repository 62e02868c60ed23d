"""Every hard case, at its reduced size, goes as its list says: what is known to fail has to."""

import json

import pytest
import torch

import torchbeam as tb
from torchbeam.studies.hard_cases.case import run
from torchbeam.studies.hard_cases.cases import CASES
from torchbeam.studies.hard_cases.command import main

LONG = {  # what holds them in the suite otherwise
    "snap-through by `path`": "test_path::test_snap_through",
    "follower load past Beck's": "test_critical::test_beck, envs/test_tasks::test_flutter_grows_unless_it_is_held",
    "dead load past Euler's, statics": "test_path::test_gradient_on_the_stable_branch",
    "ten turns and back": "test_statics::test_rolled_up_ten_times",
}


@pytest.mark.parametrize("case", [pytest.param(c, marks=[pytest.mark.long] * (c.name in LONG)) for c in CASES],
                         ids=lambda case: case.name)
def test_case(case):
    """Solved in float64, in float32, in a batch (its first sample as alone, to 1e-10) and with gradient; what each allows
    stands with the case.
    """
    results = run(case, quick=True)
    assert len(results) == 4
    surprises = [f"{r.variant}: {r.reason or 'passes'}; known: {r.known or 'nothing'}" for r in results if not r.expected]
    assert not surprises, "\n".join(surprises)


def test_command(tmp_path, capsys):
    """A case and its row, the table in both formats; the exit status says that all went as listed."""
    assert main(["--quick", "--filter", "zero everything", "--out", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "hardcases.json").read_text())
    assert [r["variant"] for r in written["results"]] == ["float64", "float32", "batch", "gradient"]
    assert all(r["ok"] for r in written["results"])
    table = (tmp_path / "hardcases.md").read_text()
    assert "| zero everything |" in table
    assert table in capsys.readouterr().out


def test_single_precision_does_not_split_intervals():
    """linspace(0, 1, 101) in float32: 100 steps of 10 ms, though its intervals differ from 0.01 by 6e-8."""
    load = tb.TipLoad(force=torch.tensor([0.0, 0.1, 0.0], dtype=torch.float32))
    of = tb.Section.circle(*(torch.tensor(v, dtype=torch.float32) for v in (0.01, 1e9, 0.3, 1e3)))
    scene = tb.Scene(tb.Beam.straight(torch.tensor(1.0, dtype=torch.float32), 1, of), [load])
    assert tb.simulate(scene, torch.linspace(0, 1, 101, dtype=torch.float32), step=0.01).stats.steps == 100
