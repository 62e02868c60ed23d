"""SensorFrame: readings in axes that are not the model's."""

import pytest
import torch

import torchbeam as tb

BEAM = tb.Beam.straight(1.0, 4, tb.Section.from_stiffness(EA=1e4, GA=1e4, GJ=1.0, EI=1.0, mass=0.2))
AXES = torch.tensor([[0.0, 0, 1], [0, -1, 0], [1, 0, 0]])


def moving():
    scene = tb.Scene(BEAM, [tb.TipLoad(force=(0, 0.3, 1.0))])
    return tb.simulate(scene, torch.linspace(0, 0.1, 6), step=0.02).state


def test_points_and_vectors_turn_as_they_should():
    state, tilt = moving(), torch.tensor([0.1, -0.2, 0.3])
    R = AXES @ torch.linalg.matrix_exp(torch.linalg.cross(tilt.expand(3, 3), torch.eye(3)).mT)
    frame = tb.SensorFrame(origin=(0.1, 0.2, 0.3), rotation=AXES, tilt=tilt)
    x, v = state.position[:, -1], state.velocity[:, -1]
    tip = tb.sensors.TipPosition
    for sensor, expected in (
        (tip(), (x - torch.tensor([0.1, 0.2, 0.3])) @ R),
        (tb.sensors.Position(1.0, BEAM), (x - torch.tensor([0.1, 0.2, 0.3])) @ R),
        (tip(reference=(1.0, 0, 0)), (x - torch.tensor([1.0, 0, 0])) @ R),
        (tb.sensors.TipVelocity(), v @ R),
        (tb.sensors.TipVelocity()["z"], (v @ R)[:, 2:]),
        (tb.sensors.Spin(-1), tb.sensors.Spin(-1)(state) @ R),
    ):
        torch.testing.assert_close(frame.of(sensor)(state), expected)
    both = tb.sensors.Stack((tip(), tb.sensors.TipVelocity()))
    assert frame.of(both)(state).shape == (6, 6)


@pytest.mark.parametrize(
    "sensor", [tb.sensors.Spin(-1, body=True), tb.sensors.RootReaction(), lambda state: state.t]
)
def test_what_is_no_point_or_vector_of_frame_a_is_refused(sensor):
    with pytest.raises(ValueError, match="point or vector"):
        tb.SensorFrame(tilt=(0, 0, 0.1)).of(sensor)


def test_a_rotation_that_is_none_is_refused():
    with pytest.raises(ValueError, match="rotation"):
        tb.SensorFrame(rotation=2 * torch.eye(3))
