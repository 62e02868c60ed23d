"""Films of the published tasks: what is drawn is what is simulated, and a file comes of it."""

import pytest
import torch

import torchbeam as tb
from training import films, tuned
from training.evaluate import make


def test_a_film_is_written(tmp_path, monkeypatch, capsys):
    """Of three pictures of a task, the first and the last of which differ."""
    pytest.importorskip("matplotlib")
    image = pytest.importorskip("PIL.Image")
    monkeypatch.setattr(films, "PICTURES", 3)
    monkeypatch.setitem(films.PLAYERS, "ik", ("resolved-rate", 0.06))
    assert films.main(["--tasks", "ik", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().out.startswith("ik: ")
    with image.open(tmp_path / "ik.gif") as film:
        assert film.n_frames == 3
        first = film.convert("RGB").tobytes()
        film.seek(2)
        assert film.convert("RGB").tobytes() != first


def test_what_is_drawn_is_what_is_simulated():
    """The arm stands where the task's does, as thick; bars lie where the episode's do."""
    for name, bars, radius in (
        ("obstacles-3d", 8, 0.03),
        ("obstacles", 6, 0.1),
        ("reach-nest", 12, 0.03),
        ("follow-3d", 0, 0.0),
    ):
        env = make(tuned.TASKS[name], 1)
        env.reset(seed=0)
        scene = films.solid(env)
        torch.testing.assert_close(scene.beam.nodes, env.task.usual.nodes)
        arm, *contacts = scene.effects
        assert float(arm.radius) == 0.05 and len(contacts) == bars
        for contact in contacts:
            assert isinstance(contact.obstacle, tb.Capsule)
            assert float(contact.obstacle.radius) == radius
        if bars and "obstacles" in name:
            ends = env.task.ends(env.state)[0].view(-1, 2, 3)
            drawn = torch.stack([c.obstacle.corners for c in contacts])
            torch.testing.assert_close(drawn, ends)
