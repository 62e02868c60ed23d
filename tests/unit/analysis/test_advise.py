"""advise: what matters for a quantity, measured by leaving it out."""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from studies.operations import operations
from torchbeam.analysis.advise import _changes, change

BEAM = tb.Beam.straight(
    1.0, 4, tb.Section.from_stiffness(EA=1e4, GA=(5.0, 4e3), GJ=1.0, EI=1.0, mass=0.2, inertia=1e-6)
)
T = torch.linspace(0, 0.12, 4)
TIP = tb.sensors.TipPosition()


def scene(*more):
    return tb.Scene(BEAM, [tb.TipLoad(force=(0, 0.3, 0)), *more])


@pytest.fixture(scope="module")
def advice():
    more = tb.Gravity((0.0, 0, -1e-4)), tb.Damping((1e-5,) * 6), tb.Gravity((0.0, -2.0, 0))
    return tb.advise(
        scene(*more), T, TIP, 0.01, step=0.02, repeats=1, show=False,
        consider=[tb.LineLoad(force=(0, 0, 1.0)), tb.Damping(1e-3)],
    )  # fmt: skip


def test_what_matters(advice):
    """By the numbers of the beam: 3 EI/(kGA L^2) = 0.6 of the tip is shear along y; the load
    against EA, the rotary inertia against EI, a weight of 2e-5 N against a load of 0.3 N are below
    1e-3; the other weight is 0.4 N.
    """
    of = {t.what: t for t in advice.trials}
    for name in ("without TipLoad", "without Gravity 2", "with LineLoad"):
        assert name in advice.matters and of[name].change > 0.1
    for name in ("without Gravity 1", "no rotary inertia"):
        assert name not in advice.matters and of[name].change < 1e-3


def test_what_air_can_do_without(monkeypatch):
    """A wing that is suddenly met by wind: Wagner's function begins with half of the lift, so lags
    change the answer by tens of per cent; a straight polar has no stall, to rounding.
    """
    monkeypatch.setenv("TORCHBEAM_ENGINE", "eager")
    polar = tb.DynamicStall(tb.Polar((-0.4, 0.0, 0.4), (-2.0, 0, 2.0), (0.02,) * 3))
    air = tb.StripAir(0.2, wind=(0, -2.0, 0.1), polar=polar)
    advice = tb.advise(tb.Scene(BEAM, [air]), T[:3], TIP, step=0.02, repeats=1, show=False)
    of = {t.what: t for t in advice.trials}
    assert "StripAir quasi-steady" in advice.matters and of["StripAir quasi-steady"].change > 0.1
    assert of["StripAir without dynamic stall"].change < 1e-9
    wing = tb.Scene(BEAM, [tb.Gravity((0, 0, -1.0)), air])
    changes = dict(_changes(wing, ()))
    plain = changes["StripAir without dynamic stall"](changes["StripAir quasi-steady"](wing))
    assert plain.effects[1].lags is None and isinstance(plain.effects[1].polar, tb.Polar)
    gone = changes["StripAir quasi-steady"](changes["without StripAir"](wing))
    assert len(gone.effects) == 1


def test_a_change_is_what_two_runs_differ_by(advice):
    """The number of one trial from the two scenes themselves."""
    more = tb.Gravity((0.0, 0, -1e-4)), tb.Damping((1e-5,) * 6)
    with_, without = (
        TIP(tb.simulate(s, T, step=0.02).state)
        for s in (scene(*more, tb.Gravity((0.0, -2.0, 0))), scene(*more))
    )
    want = ((without - with_).square().mean() / (with_ - with_[0]).square().mean()).sqrt()
    found = next(t for t in advice.trials if t.what == "without Gravity 2")
    assert_close(torch.tensor(found.change), want)


def test_a_trial_that_is_refused_says_why(advice):
    """A second damping: the trial is listed with the sentence, and counts as needed."""
    twice = next(t for t in advice.trials if t.what == "with Damping")
    assert twice.matters and math.isnan(twice.change) and "2 dampings" in twice.note
    assert "2 dampings" in str(advice)


def test_all_together(advice):
    """What does not matter is left out at once, and measured again; times are shares of the
    scene's.
    """
    assert (
        advice.together is not None
        and advice.together.change < 0.01
        and not advice.together.matters
    )
    assert advice.seconds > 0 and all(t.time > 0 for t in advice.trials if not t.note)


def test_table(capsys):
    tb.advise(scene(), T[:2], TIP, step=0.1, repeats=1)
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].split() == "trial changes the answer by time matters at 0.01".split()
    assert any(line.startswith("no extension") and line.endswith("no") for line in shown)


def test_refusals():
    with pytest.raises(
        ValueError, match="tolerance = 0 was given; a positive finite number is wanted"
    ):
        tb.advise(scene(), T, TIP, 0)


def test_change():
    """RMS of the difference over the RMS of the motion; of an answer that stands still, over
    itself.
    """
    path = torch.tensor([[1.0], [2.0], [4.0]])
    assert change(path + 0.1, path) == pytest.approx(0.1 / math.sqrt((0 + 1 + 9) / 3))
    assert change(torch.full((3, 1), 2.2), torch.full((3, 1), 2.0)) == pytest.approx(0.1)


def test_operations():
    x = torch.ones(3)
    assert operations(lambda: x + x * 2) == 2 and operations(lambda: None) == 0


def test_unknowns():
    """A load in the plane xy: 3D is not needed, rounding apart, and xz cannot be; a tip moved by
    half a length needs large rotations.
    """
    beam = tb.Beam.straight(
        1.0, 4, tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=1.0, EI=1.0, mass=0.2, inertia=1e-4)
    )
    bent = tb.Scene(beam, [tb.TipLoad(force=(0, 2.0, 0))])
    of = {t.what: t for t in tb.advise(bent, T, TIP, step=0.02, repeats=1, show=False).trials}
    assert of["in the plane xy"].change < 1e-9 and not of["in the plane xy"].matters
    assert of["in the plane xz"].matters and "out of the plane" in of["in the plane xz"].note
    assert of["small displacements"].matters
    flat = tb.simulate(tb.Scene(beam, bent.effects, small=True), T, step=0.02).tip.position
    large = tb.simulate(bent, T, step=0.02).tip.position
    want = ((flat - large).square().mean() / (large - large[0]).square().mean()).sqrt().item()
    assert of["small displacements"].change == pytest.approx(want)
