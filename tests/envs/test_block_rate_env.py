"""The path from the derivation to a policy: block rate matrix, torch.linalg.solve, torchdiffeq,
Gymnasium, backward.
"""

import gymnasium
import numpy as np
import pytest
import torch
import torchbeam_envs
from gymnasium.utils.env_checker import check_env

import torchbeam as tb

ID = "torchbeam/TipReachBlockRate-v1"


def vector(solver: str = "sweep", **changes) -> torchbeam_envs.TipReachVectorEnv:
    given = {**gymnasium.spec(ID).kwargs, **changes}
    given["solver"] = {
        **given["solver"],
        **({"solver": solver} if given["form"] == "block_rate" else {}),
    }
    return torchbeam_envs.TipReachVectorEnv(2, output="torch", **given)


def episode_return(
    policy: torch.nn.Module, env: torchbeam_envs.TipReachVectorEnv, steps: int
) -> torch.Tensor:
    observation, _ = env.reset(seed=3)
    total = 0.0
    for _ in range(steps):
        observation, reward, *_ = env.step(torch.tanh(policy(observation)))
        total = total + reward.sum()
    return total


@pytest.mark.parametrize(
    "form, solver, steps",
    [
        pytest.param("block_rate", "sweep", 16, marks=pytest.mark.long),
        ("block_rate", "sweep", 2),
        pytest.param("block_rate", "dense", 2, marks=pytest.mark.long),
        pytest.param("minimal", "", 2, marks=pytest.mark.long),
    ],
)
def test_gradient_reaches_the_policy(form, solver, steps):
    """Directional derivative of a return by the policy's weights, against central differences with
    h = 1e-5: both agree to the truncation and rounding of the difference, 1e-6. `dense` solves with
    torch.linalg.solve on the block rate matrix. Two steps suffice where only the solve or the form
    differs; that both solves agree is mixed/test_trajectories'.
    """
    torch.manual_seed(0)
    env = vector(solver, form=form)
    policy = torch.nn.Linear(env.single_observation_space.shape[0], 2)
    weights = list(policy.parameters())
    directions = [torch.randn_like(w) for w in weights]
    slopes = torch.autograd.grad(episode_return(policy, env, steps), weights)
    slope = sum((s * d).sum() for s, d in zip(slopes, directions, strict=True)).item()

    @torch.no_grad()
    def moved(h: float) -> float:
        for w, d in zip(weights, directions, strict=True):
            w += h * d
        value = episode_return(policy, env, steps).item()
        for w, d in zip(weights, directions, strict=True):
            w -= h * d
        return value

    assert slope == pytest.approx((moved(1e-5) - moved(-1e-5)) / 2e-5, rel=1e-6)


def test_it_is_an_environment():
    """Gymnasium's own checker; and as a vector, two members as two alone."""
    check_env(gymnasium.make(ID).unwrapped, skip_render_check=True)
    both = gymnasium.make_vec(ID, num_envs=2)
    one = gymnasium.make(ID)
    seen, _ = both.reset(seed=5)
    np.testing.assert_allclose(one.reset(seed=5)[0], seen[0], rtol=0, atol=0)
    action = np.float32([[0.5, -1.0], [1.0, 0.3]])
    # float32 observations
    np.testing.assert_allclose(one.step(action[0])[0], both.step(action)[0][0], rtol=0, atol=1e-6)


def test_it_moves_as_the_nodal_form_does():
    """A held force for 0.12 s: the forms are two discretisations of one rod, 10 % apart with two
    elements (measured against the nodal form with 32: 9 % of the way travelled by 0.2 s), so both
    describe the same motion.
    """
    env = vector()
    env.reset(seed=0)
    start = env.state.beam.tip.position
    for _ in range(6):
        env.step(torch.tensor([[1.0, 0.0], [0.0, 1.0]]))
    moved = env.state.beam.tip.position - start
    beam = tb.Beam.straight(0.3, 32, torchbeam_envs.plant.silicone_rod())
    fine = tb.simulate(
        tb.Scene(beam, [tb.TipLoad(force=[[0, 0.08, 0], [0, 0, 0.08]])]), [0.0, 0.12], step=0.01
    )
    way = fine.tip.position[-1] - fine.tip.position[0]
    assert (moved - way).norm() < 0.12 * way.norm()


def test_what_it_refuses():
    with pytest.raises(ValueError, match="gravity with form = 'minimal'"):
        vector(form="minimal", gravity=(0, 0, -9.81))
    with pytest.raises(ValueError, match=r"[Dd]amping"):
        vector(damping=0.01)
    with pytest.raises(ValueError, match="section = 'spaghetti'"):
        vector(section="spaghetti")
