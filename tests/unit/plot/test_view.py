"""view: what the page shows is the motion."""

import socket
import urllib.request

import numpy as np
import pytest
import torch

import torchbeam as tb
from torchbeam.math import quaternions as quat

pytest.importorskip("viser")

WIDE, FLAT = 0.08, 0.01
SECTION = tb.Section.rectangle(WIDE, FLAT, E=1e8, nu=0.33, rho=2700.0)
BEAM = tb.Beam.straight(1.0, 3, SECTION)
DIRECTLY = urllib.request.build_opener(urllib.request.ProxyHandler({}))
BALL = tb.Sphere((0.5, 0, -0.3), 0.1)


def opened(*args, **more):
    return tb.view(*args, port=0, **more)  # any that is free, whatever else this machine serves


def middles(view, name):
    """Centres of the sections (points, 3) of a beam that is drawn."""
    return np.asarray(view._drawn[name].vertices).reshape(-1, 4, 3).mean(1)


def test_a_motion_of_a_batch(capsys):
    """The tube goes through the nodes at the instant shown, with the section's sides; a slider, and
    a page that is served, and nothing is printed.
    """
    force = torch.tensor([[0.0, 0, 0], [0, 0.5, 1]])
    scene = tb.Scene(BEAM, [tb.TipLoad(force=force), tb.Gravity((0, 0, -9.81))])
    solution = tb.simulate(scene, torch.linspace(0, 0.2, 5), step=0.05)
    with opened(solution, scene=scene) as view:
        for k in (0, -1, 2):
            view.show(k)
            for sample in (0, 1):
                own = middles(view, f"sample {sample}/beam 0")[::8]
                assert np.allclose(own, solution.nodes[k, sample], atol=1e-6)
        assert view._slider.value == 2 and float(view._clock.value) == pytest.approx(0.1)
        corners = np.asarray(view._drawn["sample 0/beam 0"].vertices)[:4]
        assert np.linalg.norm(np.diff(corners, axis=0), axis=1) == pytest.approx(
            [WIDE, FLAT, WIDE], rel=1e-4
        )
        view._slider.value = 4  # as a hand does, but that its call comes from another thread
        view.show(4)
        assert np.allclose(
            middles(view, "sample 1/beam 0")[-1], solution.tip.position[4, 1], atol=1e-6
        )
        assert b"<html" in DIRECTLY.open(view.url).read()
        assert view.url in view._repr_html_()
    assert capsys.readouterr().out == ""
    assert torch.equal(view.t, solution.t.double())


def test_a_structure_with_body_tendon_and_obstacles():
    scene = tb.Scene(
        {"arm": BEAM, "hub": tb.Body(0.2, 0.1, position=(1.0, 0, 0))},
        [
            tb.Tendon([(None, (0, 0, 0.2)), ("hub", (0, 0, 0.1))], tension=1.0),
            tb.Contact("arm", BALL, thickness=0.01, force=1.0),
            tb.Contact("arm", tb.Plane((0, 0, -2.0), (0, 0, 1)), thickness=0.01, force=1.0),
            tb.Contact(
                "arm", tb.Capsule((0, 0, -1.0), (1.0, 0, -1), 0.1), thickness=0.01, force=1.0
            ),
            tb.Contact("arm", tb.Box((0, 2.0, 0), (1, 1, 1), 0.1), thickness=0.01, force=1.0),
            tb.Contact(
                "arm",
                tb.Cylinder(lambda t: torch.stack((t, t * 0, t * 0 - 2)), (0, 1.0, 0), 0.1),
                thickness=0.01,
                force=1.0,
            ),
        ],
        joints=[tb.Weld(("arm", -1), "hub")],
        supports=[tb.Support(("arm", 0))],
    )
    with opened(scene) as view:
        assert {*view._drawn} == {
            "sample 0/beam 0", "sample 0/body 0", "sample 0/body 0 dark", "tendon 0",
            *(f"obstacle {k}" for k in range(5)),
        }  # fmt: skip
        assert np.allclose(view._drawn["tendon 0"].points, [[[0, 0, 0.2], [1, 0, 0.1]]])
        ball = view._drawn["obstacle 0"].vertices - np.array(BALL.centre)
        assert np.allclose(np.linalg.norm(ball, axis=-1), 0.1, atol=1e-6) and len(ball) > 100
        view.update(tb.rest(scene, t=0.5))
        across = np.asarray(view._drawn["obstacle 4"].vertices)[:, [0, 2]] - (0.5, -2)
        assert np.allclose(np.linalg.norm(across, axis=-1), 0.1, atol=1e-6)


def test_a_file_that_plays_by_itself(tmp_path):
    solution = tb.simulate(tb.Scene(BEAM), [0.0, 0.1, 0.2], step=0.1)
    with opened(solution, samples=1) as view:
        text = view.save(tmp_path / "motion.html").read_text()
        assert "__VISER_EMBED_DATA__" in text and len(text) < 4e6
        with pytest.raises(ValueError, match=r"motion\.gif.*\.html is wanted"):
            view.save(tmp_path / "motion.gif")


def test_what_cannot_be_seen_is_refused():
    with pytest.raises(ValueError, match="Beam was given to view"):
        tb.view(BEAM)
    scene = tb.Scene(BEAM)
    for wrong in (
        dict(port="x"),
        dict(host=1),
        dict(samples=0),
        dict(speed=-1.0),
        dict(scene=BEAM),
    ):
        with pytest.raises(ValueError, match=f"{next(iter(wrong))}.* (was|of type .* was) given"):
            tb.view(scene, **wrong)
    with pytest.raises(ValueError, match="4 nodes was given to view; the scene has 3"):
        tb.view(tb.rest(tb.Scene(BEAM)), scene=tb.Scene(tb.Beam.straight(1.0, 2, SECTION)))
    with (
        opened(tb.Scene(BEAM)) as view,
        pytest.raises(ValueError, match="3 nodes was given; the view has 4"),
    ):
        view.update(tb.rest(tb.Scene(tb.Beam.straight(1.0, 2, SECTION))))


@pytest.mark.parametrize(
    "address",
    [
        dict(host="192.0.2.1"),  # of documentation: no machine has it
        dict(host="nosuch.invalid"),
        dict(host="a" * 70),
        dict(port=65536),
        dict(port=10**9),
    ],
    ids=str,
)
def test_where_no_page_can_be_served_it_is_said(address):
    with pytest.raises(ValueError, match=r"where no page can be served \(.+\); an address of this"):
        tb.view(tb.Scene(BEAM), **address)


def test_a_port_that_is_taken_is_passed_by():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with tb.view(tb.Scene(BEAM), port=port) as view:
            assert view.url.startswith("http://127.0.0.1:") and not view.url.endswith(f":{port}")


def test_bodies_alone_are_drawn_as_their_surfaces_where_they_are():
    turn = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x to y
    box, bar = tb.Box((0.1, 0, 0), (0.2, 0.1, 0.1), 0.01), tb.Capsule((0, 0, 0), (0.2, 0, 0), 0.05)
    bodies = {
        "box": tb.Body(0.1, 1e-3, rotation=turn, surface=box),
        "bar": tb.Body(0.1, 1e-3, position=(1.0, 0, 0), surface=bar),
    }
    with opened(tb.Scene(bodies)) as view:
        ends = {name: extent(view, f"sample 0/body {k}") for k, name in enumerate(bodies)}
        assert np.allclose(ends["box"], [[-0.05, 0, -0.05], [0.05, 0.2, 0.05]], atol=1e-6)
        assert np.allclose(ends["bar"], [[0.95, -0.05, -0.05], [1.25, 0.05, 0.05]], atol=1e-6)


def extent(view, name):
    """Least and largest (2, 3) m of a body's points, where it is drawn."""
    points = []
    for own in (view._drawn[name], view._drawn[f"{name} dark"]):
        R = quat.matrix(torch.tensor(own.wxyz))
        points.append(np.asarray(own.vertices) @ R.numpy().T + own.position)
    points = np.concatenate(points)
    return np.stack((points.min(0), points.max(0)))


def test_what_touches_is_as_thick_as_it_touches():
    """Each sample by its own radius, a ball without a surface as well."""
    radius = torch.tensor([0.01, 0.03])
    law = dict(thickness=0.01, force=1.0, radius=radius, other_radius=2 * radius)
    parts = {"rod": BEAM, "ball": tb.Body(0.2, 0.1, position=(0.5, 0, 0.4))}
    with opened(tb.Scene(parts, [tb.Contact("rod", "ball", **law)])) as view:
        for i, own in enumerate(radius.tolist()):
            across = np.asarray(view._drawn[f"sample {i}/beam 0"].vertices)[:, 1:]
            assert np.allclose(np.linalg.norm(across, axis=-1), own, atol=1e-6)
            ball = extent(view, f"sample {i}/body 0")
            assert np.allclose(ball.mean(0), (0.5, 0, 0.4)) and np.allclose(
                np.ptp(ball, 0), 4 * own
            )
