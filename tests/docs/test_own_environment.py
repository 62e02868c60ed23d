"""docs/own_environment.md: its code blocks as they stand, Gymnasium's checker on their env, and
what the page says of it.
"""

import importlib
import json
import re
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from torchbeam_envs.baselines import LQR, Zero

import torchbeam as tb

PAGE = (Path(__file__).parents[2] / "docs" / "own_environment.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """The first block, as a module of its own."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "tendon_arm.py").write_text(BLOCKS[0])
    sys.path.insert(0, str(folder))
    try:
        yield importlib.import_module("tendon_arm")
    finally:
        sys.path.remove(str(folder))
        gymnasium.registry.pop("TendonArm-v0", None)


def test_it_is_short():
    """About forty lines of code for the task: blank lines, comments and the imports aside."""
    body = BLOCKS[0].split("\n\n\n", 1)[1]
    assert sum(bool(line.split("#")[0].strip()) for line in body.splitlines()) <= 48


def test_the_env_keeps_the_contract(arm):
    env = gymnasium.make("TendonArm-v0", max_episode_steps=4)
    check_env(env.unwrapped, skip_render_check=True)
    assert json.loads(env.spec.to_json())["id"] == "TendonArm-v0"
    assert env.action_space.shape == (2,) and env.observation_space.shape == (3 + 12 + 2,)
    observation, _ = env.reset(seed=1)
    for k in range(4):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        assert (
            observation in env.observation_space
            and np.isfinite(reward)
            and not terminated
            and truncated == (k == 3)
        )
    assert info["distance"] > 0


def test_the_arm_hangs_and_carries(arm):
    """At rest the tip is below the root by the length and the stretch under payload and weight,
    (P + W/2) L / EA.
    """
    env = arm.ArmVectorEnv(2)
    env.reset(seed=0, options={"params": {"payload": [0.0, 0.05]}})
    tip = env.state.beam.tip.position
    EA, weight = np.pi * 1e-4 * 1e6, np.pi * 1e-4 * 1100 * 9.81 * 0.3
    stretch = [(9.81 * p + weight / 2) * 0.3 / EA for p in (0.0, 0.05)]
    np.testing.assert_allclose(tip, [[0, 0, -0.3 - s] for s in stretch], atol=1e-6)


def test_tendons_reach_the_targets(arm):
    """Baselines work through `target` and `Actuator`, whatever the actuator: LQR about the hanging
    arm, around the holding action, brings the tip to rest on its targets; without action it stays
    where it hangs.
    """
    env = arm.ArmVectorEnv(3, output="torch", autoreset_mode="Disabled", elements=2, substeps=1)
    ends = {}
    for controller in (Zero(), LQR(env, effort=0.1)):
        observation, _ = env.reset(seed=0)
        controller.begin(env)
        for _ in range(30):
            observation, *_, info = env.step(controller(observation))
        ends[type(controller)] = info["distance"]
    assert (ends[LQR] < 0.01 * env.task.length).all() and (ends[Zero] > 0.1 * env.task.length).all()


def test_the_blocks_run(arm):
    """All but stable-baselines3's, in their order, in PyTorch's own default dtype; readings are
    what the observation shows.
    """
    torch.set_default_dtype(torch.float32)
    names = dict(vars(arm))
    for block in BLOCKS[1:]:
        if "stable_baselines3" not in block:
            exec(block, names)
    payload = names["many"].state.plant.params["payload"]
    assert (payload.min() >= 0.01) and (payload.max() <= 0.05) and payload.unique().numel() == 8
    assert names["bent"].task.length == pytest.approx(0.2 * np.pi / 2)
    assert names["bent"].step(np.zeros((2, 2)))[0].shape == (2, 17)
    np.testing.assert_allclose(names["observation"][:, 3:12], names["seen"], rtol=1e-6)
    assert names["reading"].shape == (2, 9) and names["still"].shape[-1] == 9
    assert "root moment x" in names["felt"].sensors.labels
    assert names["action"].grad.isfinite().all() and (names["action"].grad != 0).any()


def test_the_gradient_is_that_of_differences(arm):
    """Of the return of four steps by constant actions; central differences, float64: their error is
    about 1e-10 / h = 1e-5.
    """
    env = arm.ArmVectorEnv(1, output="torch", elements=3)

    def total(action):
        env.reset(seed=0)
        return sum(env.step(action)[1] for _ in range(4)).sum()

    action = torch.tensor([[0.3, -0.2]], dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(total(action), action)
    for i in range(2):
        h = 1e-5 * torch.eye(2, dtype=torch.float64)[i]
        with torch.no_grad():
            assert gradient[0, i].item() == pytest.approx(
                (total(action + h) - total(action - h)).item() / 2e-5, rel=1e-4
            )


def test_in_a_plane_it_moves_as_in_space(arm):
    """`planar=True` leaves one action: in space the other is 0. Without PLANE the sentence says
    what is wanted, and a `target_high` of another size what was.
    """
    ways = {planar: arm.ArmVectorEnv(1, elements=2, planar=planar) for planar in (True, False)}
    for env in ways.values():
        env.reset(seed=0)
    assert ways[True].single_action_space.shape == (1,)
    for _ in range(4):
        ways[True].step(np.array([[0.7]]))
        ways[False].step(np.array([[0.7, 0.0]]))
    flat, tip = (env.state.beam.tip.position for env in ways.values())
    assert abs(tip[0, 0]) > 0.005
    torch.testing.assert_close(flat, tip, rtol=0, atol=1e-9)

    class Across(arm.ArmReach):
        PLANE = "xy"

    class AcrossVectorEnv(arm.BeamVectorEnv):
        task_type = Across

    with pytest.raises(ValueError, match=r"in the plane 'xy'.*PLANE = 'xz' or 'xy' .* is wanted"):
        AcrossVectorEnv(1, planar=True)

    class Tall(arm.ArmReach):
        def target_high(self):
            return np.full(3, 4.0)

    class TallVectorEnv(arm.BeamVectorEnv):
        task_type = Tall

    with pytest.raises(ValueError, match=r"target_high .* 3 .* target_observation .* 2"):
        TallVectorEnv(1, elements=2, planar=True).reset(seed=0)


def test_pictures(arm):
    pytest.importorskip("pygame")
    env = arm.ArmEnv(render_mode="rgb_array", elements=2)
    env.reset(seed=0)
    picture = env.render()
    assert picture.dtype == np.uint8 and (picture.reshape(-1, 3).std(0) > 1).all()


def test_stable_baselines3_in_three_lines(arm):
    pytest.importorskip("stable_baselines3")
    block = next(block for block in BLOCKS if "stable_baselines3" in block)
    torch.set_default_dtype(torch.float32)
    names = dict(vars(arm))
    exec(block, names)
    assert names["model"].num_timesteps == 64


def test_another_support_and_actuator(arm):
    """A beam pinned at its root and held at its tip along x and y, driven by a torque at the root:
    it turns about z alone at node 0 and the actions are what the configuration says.
    """
    import torchbeam_envs

    motor = torchbeam_envs.Actuator(
        tb.PointLoad(0, moment=tb.Input("torque", 3)), [[0.0, 0.0, 0.01]]
    )
    held = (tb.Support(0, rotation="xy"), tb.Support(-1, position="yz", rotation=""))

    class Hold(torchbeam_envs.Task):
        def cost(self, now):
            return now.beam.position[:, -1].square().sum(-1)

    class HoldVectorEnv(torchbeam_envs.BeamVectorEnv):
        task_type = Hold

    env = HoldVectorEnv(2, supports=held, actuators=motor, gravity=None, elements=4, delay=0)
    assert env.single_action_space.shape == (1,)
    env.reset(seed=0)
    for _ in range(3):
        env.step(np.array([[1.0], [-1.0]]))
    beam = env.state.beam
    assert beam.spin[:, 0, 2].abs().min() > 0 and beam.spin[:, 0, :2].abs().max() < 1e-9
    assert beam.position[:, -1, 1:].abs().max() < 1e-9
    torch.testing.assert_close(beam.position[0, :, 1], -beam.position[1, :, 1], rtol=0, atol=1e-9)
