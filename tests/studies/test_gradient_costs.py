"""python -m studies gradients: every way finds the same gradient; files, budgets and failures of
rows.
"""

import json
import subprocess

import pytest
import torch

from studies import gradient_costs as costs

pytest.importorskip("llvmlite")
IMPLICIT = [way for way in costs.WAYS if way not in (*costs.FORWARD, *costs.EXPLICIT)]


def test_every_way_finds_the_gradient():
    """Of the implicit steps: to rounding, by differences to 1e-6 (steps of 1e-4); of the explicit
    ones the continuous adjoint errs by what the state, integrated back, misses itself by: 1e-3
    here.
    """
    exact = costs.gradient(costs.REFERENCES[0], 2, 4)
    assert exact.shape == (2,) and exact.abs().min() > 0
    for way in IMPLICIT[:1] + IMPLICIT[2:]:
        off = (costs.gradient(way, 2, 4) - exact).abs().max() / exact.abs().max()
        assert off < (1e-6 if way.startswith("differences") else 1e-10), way
    continuous, discrete = (costs.gradient(way, 2, 1) for way in costs.EXPLICIT)
    assert (continuous - discrete).abs().max() < 1e-3 * discrete.abs().max()
    runs = [costs.gradient(way, 2, 4) for way in costs.FORWARD]
    assert runs[0].shape == (1,) and torch.allclose(*runs, rtol=1e-10)


def test_files(tmp_path, capsys, monkeypatch):
    """Rows as they are measured, with errors and ratios; a way over its budget is left out of
    larger problems, one that fails says why.
    """

    def apart(function, way, parameters, steps, repeats, budget, limit):
        if way == "adjoint, eager":
            raise subprocess.TimeoutExpired("run", limit)
        if way in costs.EXPLICIT:
            raise RuntimeError("failed in a process of its own:\nTraceback\nRuntimeError: no steps")
        off = 1e-7 if way.startswith("differences") else 0.0
        return {
            "seconds": 2.0 if way.startswith("adjoint") else 0.5,
            "MB": 3.0,
            "gradient": [1.0 + off] * parameters,
        }

    monkeypatch.setattr(costs, "apart", apart)
    assert costs.main(["--quick", "--out", str(tmp_path), "--budget", "5"]) == 0
    found = json.loads((tmp_path / "gradients.json").read_text())
    rows = {(r["way"], r["parameters"]): r for r in found["rows"]}
    assert found["budget"] == 5 and len(rows) == 2 * len(costs.WAYS)
    assert len((tmp_path / "gradients.csv").read_text().splitlines()) == len(rows) + 1
    assert (
        rows["adjoint, eager", 1]["status"] == "over 5 s"
        and rows["adjoint, eager", 4]["status"] == "left out"
    )
    assert rows["explicit form, odeint_adjoint", 1]["status"] == "failed: RuntimeError: no steps"
    assert rows["adjoint, compiled", 1]["over"] == 4.0 and rows["differences, compiled", 4][
        "error"
    ] == pytest.approx(1e-7)
    text = capsys.readouterr().out
    assert (
        text == (tmp_path / "gradients.md").read_text()
        and "| differences, compiled | 4 | 10 | 0.5 |" in text
    )
    assert (tmp_path / "gradients.png").stat().st_size > 10_000
    with pytest.raises(SystemExit):
        costs.main(["--budget", "0"])


def test_a_row_is_measured():
    """CPU seconds, memory and the gradient, by what the processes run."""
    found = costs.measured("adjoint, compiled", 2, 4, 2, 60.0)
    assert found["seconds"] > 0 and found["MB"] >= 0 and len(found["gradient"]) == 2
