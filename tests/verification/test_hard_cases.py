"""Every hard case, at its reduced size, goes as its list says: what is known to fail has to."""

import json

import pytest
import torch

import torchbeam as tb
from studies.hard_cases.case import run
from studies.hard_cases.cases import CASES
from studies.hard_cases.command import main

LONG = {  # what holds them in the suite otherwise
    "snap-through by `path`": "test_path::test_snap_through",
    "follower load past Beck's": "test_critical::test_beck, envs/test_tasks::test_flutter_grows_unless_it_is_held",
    "dead load past Euler's, statics": "test_path::test_gradient_on_the_stable_branch",
    "ten turns and back": "ten turns by an end moment",
    "root spun through 20 revolutions": "frame spun, test_prescribed_motion::test_a_turning_frame_is_a_turning_root",
    "frame spun through 20 revolutions": (
        "test_prescribed_motion::{test_a_turning_frame_is_a_turning_root, "
        "test_steady_rotation_is_steady}"
    ),
    "ten turns by an end moment": "ten turns out of plane, test_statics::test_rolled_up_by_an_end_moment",
    "bending stiffness ratio 1e6": "bending stiffness ratio 1e6, sudden",
    "clamp of 1e-4 N/m and N m": "clamp of 1e8 and 1 N m, free beam, pushed",
    "payload of 100 times the beam's mass": "test_effects::test_payload_moves_as_its_mode, "
    "test_prescribed_motion::test_energy_with_an_eccentric_mass_is_second_order",
    "EA = GA = inf": (
        "test_gradients::test_gradient_of_what_cannot_stretch_is_exact, "
        "test_compiled_step: inextensible"
    ),
    "slenderness 1e6 in the plane xz": "slenderness 1e6, test_coordinates::test_plane_is_3d",
    "hinged beam that falls": "test_prescribed_motion::test_pendulum",
    "one NaN and one impossible load in 256": (
        "unit/core/test_batch_subset::test_samples_that_fail_are_left_out, "
        "test_dynamics::test_absurd_samples_are_reported_and_harm_nobody"
    ),
}
# fmt: off
NATIVE = [  # of one program, so that it is compiled once
    "slenderness 10", "slenderness 1000", "slenderness 1e6", "elements 1e6 times stiffer by turns",
    "elements of mass ratio 1e-6 by turns", "bending stiffness ratio 1e6, sudden",
    "P L^2/EI = 10, sudden, dt = 10 ms",
    "P L^2/EI = 50, sudden, dt = 10 ms", "load reversed every step",
    "dead load past Euler's, dynamics", "snap-through",
    "100,000 steps undamped", "1 element", "256 elements", "dt = 1e-5 s", "dt = 0.5 s",
]
# fmt: on


def cases():
    """Each by one engine: the default one where `NATIVE`, and then by eager steps as a long run."""
    for case in CASES:
        yield pytest.param(
            case,
            "auto" if case.name in NATIVE else "eager",
            id=case.name,
            marks=[pytest.mark.long] * (case.name in LONG),
        )
        if case.name in NATIVE:
            yield pytest.param(case, "eager", id=f"{case.name}, eager", marks=pytest.mark.long)


@pytest.mark.parametrize("case, engine", [*cases()])
def test_case(case, engine, monkeypatch):
    """Solved in float64, in float32, in a batch (its first sample as alone, to 1e-10) and with
    gradient; what each allows stands with the case.
    """
    monkeypatch.setenv("TORCHBEAM_ENGINE", engine)
    results = run(case, quick=True)
    assert len(results) == 4
    surprises = [
        f"{r.variant}: {r.reason or 'passes'}; known: {r.known or 'nothing'}"
        for r in results
        if not r.expected
    ]
    assert not surprises, "\n".join(surprises)


def test_what_is_listed_is_a_case():
    assert {*LONG, *NATIVE} <= {case.name for case in CASES}


def test_command(tmp_path, capsys, monkeypatch):
    """A case and its row, the table in both formats; the exit status says that all went as
    listed.
    """
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")  # as `test_case` has it
    assert main(["--quick", "--filter", "zero everything", "--out", str(tmp_path)]) == 0
    written = json.loads((tmp_path / "hardcases.json").read_text())
    assert [r["variant"] for r in written["results"]] == ["float64", "float32", "batch", "gradient"]
    assert all(r["ok"] for r in written["results"])
    table = (tmp_path / "hardcases.md").read_text()
    assert "| zero everything |" in table
    assert table in capsys.readouterr().out


def test_single_precision_does_not_split_intervals():
    """linspace(0, 1, 101) in float32: 100 steps of 10 ms, though its intervals differ from 0.01 by
    6e-8.
    """
    beam = tb.Beam.straight(1.0, 1, tb.Section.circle(0.01, 1e9, 0.3, 1e3))
    t = torch.linspace(0, 1, 101, dtype=torch.float32)
    for dtype in (torch.float32, torch.float64):
        scene = tb.Scene(beam, [tb.TipLoad(force=(0.0, 0.1, 0.0))], dtype=dtype)
        assert tb.simulate(scene, t, step=0.01).stats.steps == 100
