"""Pictures: their shape, what moves in them, the window, videos. (Whether they are good was looked
at.)
"""

from importlib.metadata import requires

import gymnasium
import numpy as np
import pytest
from torchbeam_envs import TipReachEnv, TipReachVectorEnv

pytest.importorskip("pygame")
SMALL = dict(elements=2, substeps=1)


def colored(picture, color, tolerance=40):
    """Pixels near a color, (k, 2) row and column."""
    return np.argwhere(np.abs(picture.astype(int) - color).max(-1) < tolerance)


def test_a_single_env_draws_its_beam_its_target_and_its_force():
    """From above the beam reaches over 80 % of its view's width; the arrow starts at the tip and
    points to +y: upwards.
    """
    from torchbeam_envs.rendering import BEAM, FORCE, TARGET

    env = gymnasium.make("torchbeam/TipReach-v1", render_mode="rgb_array", **SMALL)
    env.reset(seed=0)
    start = env.render()
    assert start.dtype == np.uint8 and start.ndim == 3 and start.shape[2] == 3
    assert start.shape[0] % 2 == start.shape[1] % 2 == 0  # what video codecs want
    for _ in range(3):
        env.step(np.array([1.0, 0.0]))
    picture = env.render()[:, : start.shape[1] // 2]
    beam, arrow, target = (colored(picture, color) for color in (BEAM, FORCE, TARGET))
    assert 0.78 < np.ptp(beam[:, 1]) / picture.shape[1] < 0.85 and len(target) > 20
    assert (
        not len(colored(start, FORCE))
        and arrow[:, 0].max() <= beam[:, 0].max()
        and np.ptp(arrow[:, 0]) > 30
    )
    assert abs(arrow[:, 1].mean() - beam[:, 1].max()) < 5
    assert env.metadata["render_fps"] == 50 and set(env.metadata["render_modes"]) == {
        "rgb_array",
        "human",
    }


def test_many_are_tiled():
    """The first 16 of 20, four by four; one view each in a plane."""
    env = TipReachVectorEnv(20, render_mode="rgb_array", planar=True, **SMALL)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    frames, tiled = env.render(), env.tiled()
    assert len(frames) == 20 and tiled.shape[0] <= 1000 and tiled.shape[1] <= 1280
    tiles = [tile for row in np.array_split(tiled, 4) for tile in np.array_split(row, 4, axis=1)]
    assert (
        all((tile == frame).all() for tile, frame in zip(tiles, frames, strict=False))
        and len(tiles) == 16
    )
    assert len({tile.tobytes() for tile in tiles}) == 16  # sixteen targets


def test_traces_begin_with_their_episodes():
    env = TipReachVectorEnv(
        2, render_mode="rgb_array", max_episode_steps=3, autoreset_mode="NextStep", **SMALL
    )
    env.reset(seed=0)
    for k in range(6):
        assert [len(t) for t in env.renderer.traces] == 2 * [k % 4 + 1]
        env.step(np.zeros((2, 2)))


def test_a_window(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = TipReachEnv(render_mode="human", **SMALL)
    env.reset(seed=0)
    env.step(np.zeros(2))
    assert env.one.renderer.window is not None and env.render() is None
    env.close()
    assert env.one.renderer.window is None


def test_render_before_reset_and_without_mode():
    with pytest.raises(gymnasium.error.ResetNeeded):
        TipReachVectorEnv(render_mode="rgb_array", **SMALL).render()
    with pytest.raises(gymnasium.error.ResetNeeded):
        TipReachVectorEnv(**SMALL).tiled()
    env = TipReachVectorEnv(**SMALL)
    env.reset()
    with pytest.warns(UserWarning, match="without a render_mode"):
        assert env.render() is None


def test_the_extra_for_videos_brings_what_they_take():
    """Pictures, and moviepy, without which the next test is left out."""
    named = {line.split(";")[0] for line in requires("torchbeam") if 'extra == "video"' in line}
    assert "torchbeam[render]" in named and any(name.startswith("moviepy") for name in named)


@pytest.mark.parametrize("vector", [False, True])
def test_record_video(tmp_path, vector):
    pytest.importorskip("moviepy")
    made = dict(render_mode="rgb_array", max_episode_steps=3, **SMALL)
    if vector:
        env = gymnasium.make_vec("torchbeam/TipReachPlanar-v1", num_envs=2, **made)
        env = gymnasium.wrappers.vector.RecordVideo(
            env, str(tmp_path), episode_trigger=lambda k: k == 0, video_length=3
        )
    else:
        env = gymnasium.make("torchbeam/TipReach-v1", **made)
        env = gymnasium.wrappers.RecordVideo(env, str(tmp_path))
    env.reset(seed=0)
    for _ in range(4 if vector else 3):
        env.step(env.action_space.sample())
    env.close()
    assert [p.stat().st_size > 1000 for p in tmp_path.glob("*.mp4")] == [True]
