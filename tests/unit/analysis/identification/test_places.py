"""Places, frames and states of rest in `identify`; what an instrument would read in `predict`."""

from dataclasses import replace

import pytest
import torch

import torchbeam as tb
from tests.cases.refusals import refusals

AXES = [[0.0, 0, 1], [0, -1, 0], [1, 0, 0]]
FORCES = torch.tensor([[0, 0.3, 1.0], [0, -0.5, -2.0], [0.4, 0, 1.5]])


def section(EI):
    return tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=EI, mass=0.2, inertia=1e-5)


BEAM = tb.Beam.straight(1.0, 4, section(1.0))


def rest(theta, engine="eager"):
    beam = tb.Beam.straight(1.0, 4, section(theta["EI"][:, None]))
    scene = tb.Scene(beam, [tb.TipLoad(force=FORCES)])
    return tb.equilibrium(scene, throw=False, engine=engine)


FRAME = tb.SensorFrame(origin="origin", rotation=AXES, tilt="tilt")
MARKERS = [
    tb.Measurement(
        torch.zeros(3, 3),
        1e-5,
        sensor=tb.sensors.Position(s, BEAM),
        place=place,
        frame=FRAME,
        name=name,
    )
    for s, place, name in (
        (0.5, {"station": "s", "point": "p"}, "middle"),
        (1.0, {}, "tip"),
        (0.25, {}, "low"),
    )
]
TRUE = {
    "EI": torch.tensor([1.3]), "s": torch.tensor([0.63]), "p": torch.tensor([[0.0, 0.02, 0.03]]),
    "tilt": torch.tensor([[0.05, -0.04, 0.1]]), "origin": torch.tensor([[0.1, 0.2, 0.3]]),
}  # fmt: skip
START = {
    "EI": 1.0,
    "s": tb.Parameter(0.5, bounds=(0, 1)),
    "p": tb.Parameter(torch.zeros(3), prior=torch.distributions.Normal(0.0, 0.05)),
    "tilt": tb.Parameter(torch.zeros(3), scale=0.1),
    "origin": tb.Parameter(torch.zeros(3), scale=0.1),
}


@pytest.mark.parametrize("derivatives", ["difference", "forward"])
def test_a_place_and_a_frame_are_found_with_a_stiffness(derivatives):
    """From readings without noise; the prior of the point leaves s and p[0], along the beam, where
    it is (0 in truth).
    """
    state = rest(TRUE)
    seen = [replace(m, values=m.read(state, TRUE)[0]) for m in MARKERS]
    fit = tb.identify(rest, seen, START, derivatives=derivatives)
    assert fit.status == 0
    for name, value in TRUE.items():
        torch.testing.assert_close(fit[name], value[0], rtol=0, atol=1e-4)


def test_both_engines_read_the_same():
    for m in MARKERS:
        torch.testing.assert_close(
            m.read(rest(TRUE), TRUE), m.read(rest(TRUE, "compiled"), TRUE), rtol=0, atol=1e-7
        )


def swing(theta):
    scene = tb.Scene(
        tb.Beam.straight(1.0, 4, section(theta["EI"])), [tb.TipLoad(force=(0, 0.5, 1.0))]
    )
    return tb.simulate(scene, torch.linspace(0, 0.3, 16), step=0.02, engine="compiled")


def test_an_instrument_reads_in_a_prediction_what_it_read_in_the_fit():
    t = torch.linspace(0.02, 0.2, 10)
    laser = tb.Measurement(
        torch.zeros(10, 3), 1e-3, times=t, sensor=tb.sensors.Position(0.8, BEAM),
        frame=tb.SensorFrame(tilt="tilt"), delay="delay", offset=True, drift=True, name="laser",
    )  # fmt: skip
    true = {k: TRUE[k] for k in ("EI", "tilt")} | {"delay": torch.tensor([0.01])}
    y = laser.read(swing(true), true)[0]
    line = torch.tensor([0.1, 0.2, 0.3]) + torch.tensor([1.0, 0.0, -1.0]) * t[:, None]
    start = {k: START[k] for k in ("EI", "tilt")} | {"delay": tb.Parameter(0.0, scale=0.01)}
    fit = tb.identify(swing, replace(laser, values=y + line), start, derivatives="difference")
    again, low, high = fit.predict(measurement="laser")
    torch.testing.assert_close(again, fit.y)
    later = torch.tensor([0.22, 0.25])
    ahead = replace(laser, values=torch.zeros(2, 3), sigma=1e-3, times=later).read(
        swing(true), true
    )[0]
    line = torch.tensor([0.1, 0.2, 0.3]) + torch.tensor([1.0, 0.0, -1.0]) * later[:, None]
    prediction = fit.predict(measurement="laser", times=later)
    torch.testing.assert_close(prediction.y, ahead + line, rtol=0, atol=1e-4)
    # the offset's share: away from the data the line is known less well
    assert (prediction.deviation[1] > (high - low).amin(0) / 4).all()
    with pytest.raises(ValueError, match="'laser'"):
        fit.predict(measurement="camera")


@refusals(
    (dict(place={"station": "s"}, sensor=tb.sensors.TipPosition()), "station"),
    (dict(place={"node": "s"}, sensor=lambda state: state.t), "tb.sensors"),
    (dict(frame=FRAME), "tb.sensors"),
    (dict(sensor=tb.sensors.TipPosition(), delay=0.1), "times=... is wanted"),
)
def test_what_fits_no_sensor_is_refused(given):
    tb.Measurement(torch.zeros(4, 3), **given)


def test_a_state_needs_no_times_and_a_solution_does():
    with pytest.raises(ValueError, match="with times"):
        tb.identify(rest, replace(MARKERS[0], times=torch.zeros(3)), START)
    with pytest.raises(ValueError, match="without times"):
        tb.identify(swing, MARKERS[1], {k: START[k] for k in ("EI", "tilt", "origin")})
