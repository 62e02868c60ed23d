"""Pictures: each is a real image whose lines hold the numbers they should; nothing needs matplotlib
until it is drawn.
"""

import errno
import math
import os
import sys
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam import extend

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")
SECTION = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
BEAM = tb.Beam.straight(1.0, 4, SECTION)
SCENE = tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, 1.0)), tb.Damping(0.005)])
ROUND = tb.Scene(tb.Beam.curve(1.0, 4, SECTION, (0, 0.5, 1.0)), [tb.TipLoad(force=(0, 0.5, 1.0))])


@pytest.fixture(scope="module")
def solution():
    return tb.simulate(SCENE, torch.linspace(0, 0.4, 9), step=0.05)


def drawn(ax, path):
    """Save: the picture's pixels, of which some and not all are ink."""
    pixels = np.asarray(Image.open(tb.plot.save(ax, path, dpi=60)).convert("L"))
    ink = (pixels < 200).mean()
    assert 0.002 < ink < 0.4, ink
    return pixels


def data(ax):
    """Every line's points, by its place."""
    lines = [
        np.stack(line.get_data_3d() if ax.name == "3d" else line.get_data(), -1).astype(float)
        for line in ax.lines
    ]
    return [torch.from_numpy(x) for x in lines]


def test_shape_in_a_plane(solution, tmp_path):
    """A beam that stays in the x-z plane is drawn flat, through its nodes."""
    ax = tb.plot.shape(solution.state[::4])
    drawn(ax, tmp_path / "deep" / "shape.png")
    curve, dots = data(ax)[:2]
    assert ax.name != "3d" and ax.get_ylabel() == "z / m"
    assert_close(dots, solution.nodes[0][:, [0, 2]])
    assert_close(curve[::8], dots)
    assert len(ax.lines) == 6  # a curve and its nodes, three times


def test_shape_is_the_circle_between_nodes():
    """A quarter of a circle in four elements of the angle phi: the cubic's tangents are as long as
    the chords, and half way it leaves the circle by 2 sin(phi/4)^4, by hand: 1.8e-4 of the radius.
    """
    ax = tb.plot.shape(tb.rest(tb.Scene(tb.Beam.arc(1.0, math.pi / 2, 4, SECTION))))
    radius = (data(ax)[0] - torch.tensor([0.0, 1.0])).norm(dim=-1)
    assert_close(
        (radius - 1).abs().max(), torch.tensor(2 * math.sin(math.pi / 32) ** 4), rtol=1e-6, atol=0
    )


def test_shape_in_space(tmp_path):
    """With the axes of five sections, three each."""
    ax = tb.plot.shape(tb.equilibrium(ROUND), frames=True)
    drawn(ax, tmp_path / "shape.png")
    assert ax.name == "3d" and len(ax.lines) == 2 + 15
    flat = tb.plot.shape(tb.equilibrium(ROUND), plane="xy", nodes=False, color="k")
    drawn(flat, tmp_path / "flat.png")
    assert flat.name != "3d" and len(flat.lines) == 1


def test_mode_shapes(tmp_path):
    """The first bending mode at rest: largest displacement 0.15 of the length, at the tip;
    frequencies in the legend.
    """
    still = tb.Scene(BEAM)
    modes = tb.modes(still, count=3)
    ax = tb.plot.mode_shapes(tb.rest(still), modes, count=3, plane="xz")
    drawn(ax, tmp_path / "modes.png")
    first = data(ax)[1]
    assert_close(first[:, 1].abs().amax(), torch.tensor(0.15))
    assert_close(first[-1, 1].abs(), torch.tensor(0.15))
    hz = [float(text.get_text().split()[1]) for text in ax.get_legend().get_texts()]
    assert_close(torch.tensor(hz), modes.frequency / (2 * torch.pi), rtol=1e-3, atol=0)


def test_orbits(tmp_path):
    """Nodes go round circles, ahead about x, the largest of 0.1 of the length; a dot is where they
    begin, nine tenths of a turn before they end.
    """
    state = tb.rest(tb.Scene(BEAM))
    motion = torch.zeros(state.position.shape[-2], 6, dtype=torch.complex128)
    motion[-1, 1], motion[-1, 2] = 3.0, -3.0j  # y = cos, z = sin
    ax = tb.plot.orbits(state, motion, tb.plot.axes(), scale=0.1, plane="yz")
    drawn(ax, tmp_path / "orbits.png")
    orbit, dot = data(ax)[-2:]
    middle = orbit - state.position[-1, 1:]
    assert_close(middle.norm(dim=-1), torch.full_like(middle[:, 0], 0.1))
    assert_close(middle[0], torch.tensor([0.1, 0.0]))
    assert_close(dot[0], orbit[0])
    turned = torch.atan2(middle[-1, 1], middle[-1, 0])
    assert_close(turned, torch.tensor(-0.2 * torch.pi))


def test_a_film_of_a_mode(tmp_path):
    """Two seconds of one period, that run on: the first picture has the tip at 0.2 of the length,
    the middle one at the other side; its frequency above. A torsion turns what is solid.
    """
    scene = tb.Scene(BEAM, plane="xz")
    modes = tb.modes(scene, count=2)
    path = tb.plot.mode_film(modes, tmp_path / "mode.gif", mode=2, scale=0.2, fps=5, dpi=50)
    film = Image.open(path)
    assert film.n_frames == 10 and film.info["duration"] == 200
    rows = []
    for k in (0, 5):
        film.seek(k)
        blue = np.asarray(film.convert("RGB")).astype(int)
        at = np.argwhere((blue[..., 2] - blue[..., 0] > 60) & (blue[..., 0] < 120))
        rows.append(at[at[:, 1] > at[:, 1].max() - 6, 0].mean())
    assert abs(rows[0] - rows[1]) > 30
    fine = tb.Scene(tb.Beam.straight(1.0, 8, SECTION, order=2), plane="xz")
    ax, flat = tb.plot.axes(), tb.modes(fine, count=6)
    tb.plot.mode_film(flat, tmp_path / "sixth.gif", ax, mode=6, fps=1, plane="xz")
    drawn_first = data(ax)[0]
    exact = data(tb.plot.mode_shapes(flat.state, flat, count=6))[6]
    off = (drawn_first[:, None] - exact).norm(dim=-1).amin(1).max()
    assert off < 0.01  # the axes tilt as the beam does: no kink at a node
    modes = tb.modes(tb.Scene(BEAM), count=8)
    spin = modes.shape[..., 3].abs().amax(-1) / modes.shape[..., :3].abs().flatten(1).amax(-1)
    path = tb.plot.mode_film(
        modes, tmp_path / "torsion.gif", mode=int(spin.argmax()) + 1, scene=tb.Scene(BEAM), fps=2
    )
    assert Image.open(path).n_frames == 4
    for wrong, said in ((9, "mode = 9 was given of 8 modes"), (0, "a whole number of at least 1")):
        with pytest.raises(ValueError, match=said):
            tb.plot.mode_film(modes, path, mode=wrong)
    many = tb.modes(tb.Scene(BEAM, [tb.TipLoad(force=torch.rand(2, 3))]), count=1)
    with pytest.raises(ValueError, match="given to mode_film; one sample"):
        tb.plot.mode_film(many, path)
    with pytest.raises(ValueError, match="modes without their equilibrium were given"):
        tb.plot.mode_film(replace(modes, state=None), path)


def test_history_and_energies(solution, tmp_path):
    left, right = tb.plot.grid(1, 2)
    assert tb.plot.history(solution, tb.sensors.TipPosition(), left, label="tip") is left
    tb.plot.energies(solution, right)
    drawn(left, tmp_path / "both.png")
    for line, k in zip(data(left), range(3), strict=True):
        assert_close(line[:, 1], solution.tip.position[:, k])
    assert [t.get_text() for t in left.get_legend().get_texts()] == ["tip x", "tip y", "tip z"]
    assert left.get_ylabel() == "tip position / m"
    assert_close(data(right)[2][:, 1], solution.energy.kinetic + solution.energy.strain)


def test_history_of_a_batch(tmp_path):
    batch = tb.simulate(
        tb.Scene(BEAM, [tb.TipLoad(force=torch.rand(5, 3))]), [0.0, 0.05, 0.1], step=0.05
    )
    ax = tb.plot.history(batch, tb.sensors.TipPosition()["z"])
    drawn(ax, tmp_path / "batch.png")
    assert len(ax.lines) == 5
    with pytest.raises(ValueError, match=r"a batch \(5,\) of solutions"):
        tb.plot.energies(batch)


@pytest.mark.parametrize("order", [1, 2])
def test_diagram_of_a_bending_moment(order, tmp_path):
    """Of a cantilever under an even load, on the side that it stretches; the values at its ends."""
    beam = tb.Beam.straight(1.0, 4, SECTION, order=order)
    scene = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -0.01))], small=True)
    ax = tb.plot.diagram(tb.equilibrium(scene), "M2", scene=scene, plane="xz", height=0.25)
    drawn(ax, tmp_path / "moment.png")
    axis, curve = data(ax)[:2]
    curve = curve[1:-1]
    assert len(axis) == len(curve)
    assert_close(curve[:, 1] - axis[:, 1], 0.25 * (1 - axis[:, 0]) ** 2, rtol=0, atol=1e-4)
    (text,) = ax.texts  # points: outward, beside the curve
    assert text.get_text() == "0.005" and text.get_va() == "bottom"
    assert abs(text.get_position()[0]) < 0.1 and 4 < text.get_position()[1] < 6
    # across the beam there are no metres
    assert ax.get_title() == "M2 / N m" and ax.get_xlabel() == "x / m"
    assert ax.get_ylabel() == "" and not len(ax.get_yticks())
    inside = ax.get_window_extent()
    assert inside.y0 < text.get_window_extent().y0 and text.get_window_extent().y1 < inside.y1


@pytest.mark.parametrize("back", [False, True])
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("plane", ["xz", "xy"])
def test_diagrams_as_textbooks_sign_them(plane, turned, back):
    """A beam on two supports under q: V = q L/2 at the left support, -q L/2 at the right one, the
    sagging M = q L^2/8 in the middle, whichever section axis lies in the plane, whether it points
    up or down, and whichever way the beam goes. Pulled by P: N = P. Positive N and V stand above,
    and M below.
    """
    L, q, P = 2.0, 4.0, 3.0
    section = tb.Section.from_stiffness(EA=1e9, GA=1e9, GJ=1e4, EI=1e6, mass=1.0)
    way = -1.0 if back else 1.0
    up = torch.tensor([0.0, 0, 1.0] if plane == "xz" else [0.0, 1.0, 0])
    beam = tb.Beam.straight(L, 4, section, direction=(way, 0, 0), up=-up if turned else up)
    held = "xz" if plane == "xz" else "xy"
    supports = [tb.Support(0, rotation=held), tb.Support(-1, position="yz", rotation=held)]
    loads = [tb.LineLoad(force=-q * up), tb.PointLoad(-1, force=(way * P, 0, 0))]
    scene = tb.Scene(beam, loads, supports=supports, plane=plane)
    state = tb.equilibrium(scene)
    pictures = {name: tb.plot.diagram(state, name, scene=scene) for name in "NVM"}
    values = {name: [text.get_text() for text in ax.texts] for name, ax in pictures.items()}
    assert values == {"N": ["3"], "V": ["-4", "4"] if back else ["4", "-4"], "M": ["2"]}
    for name, ax in pictures.items():
        curve = data(ax)[1]
        for text in ax.texts:
            place = torch.tensor(text.xy, dtype=curve.dtype)
            assert (curve - place).norm(dim=-1).min() < 1e-6
            assert (place[1] > 0) == (float(text.get_text()) > 0) ^ (name == "M")


STIFF = tb.Section.from_stiffness(EA=1e9, GA=1e9, GJ=1e6, EI=1e6, mass=1.0)


@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_diagrams_of_a_post_stand_beside_it(turned):
    """Pulled up by P and pushed to the right by H at its top, N = P and V = H stand on the left of
    its way up, and M = -H L, on the stretched side, too.
    """
    post = tb.Beam.straight(2.0, 4, STIFF, direction=(0, 0, 1.0), up=(turned, 0, 0))
    scene = tb.Scene(post, [tb.TipLoad(force=(3.0, 0, 5.0))], plane="xz", small=True)
    state = tb.equilibrium(scene)
    for name, value in {"N": "5", "V": "3", "M": "-6"}.items():
        ax = tb.plot.diagram(state, name, scene=scene)
        assert [text.get_text() for text in ax.texts] == [value]
        assert data(ax)[1][:, 0].min() < -0.1 and data(ax)[1][:, 0].max() < 1e-9
        assert ax.get_xlabel() == "" and ax.get_ylabel() == "z / m"


def test_first_order_diagrams_stand_on_the_undeformed_axis():
    """Of a beam so soft that it sags by a third of its length: its axis is straight."""
    beam = tb.Beam.straight(2.0, 4, SECTION)
    scene = tb.Scene(beam, [tb.TipLoad(force=(0, 0, -0.3))], plane="xz", small=True)
    state = tb.equilibrium(scene)
    assert state.tip.position[2] < -0.3
    axis = data(tb.plot.diagram(state, "M", scene=scene, symbols=True))[0]
    assert_close(axis[[0, -1]], axis.new_tensor([[0, 0], [2.0, 0]]))
    assert axis[:, 1].abs().max() < 1e-12


def on_supports(*loads, inner=()):
    """A beam of 8 m on supports at its ends, and at nodes in it."""
    held = [tb.Support(node, position="yz", rotation="xz") for node in (*inner, -1)]
    supports = [tb.Support(0, rotation="xz"), *held]
    beam = tb.Beam.straight(8.0, 8, STIFF, order=2)
    return tb.Scene(beam, [*loads], supports=supports, plane="xz", small=True)


@pytest.mark.parametrize(
    ("name", "scene", "values"),
    [
        # a couple M at 3/8 L: M a/L before it and -M (1 - a/L) behind
        ("M", on_supports(tb.PointLoad(6, moment=(0, 800.0, 0))), {"-300", "500"}),
        # the same upon a force: P a b/L = 3750 before and behind
        (
            "M",
            on_supports(
                tb.PointLoad(6, moment=(0, 800.0, 0)), tb.PointLoad(6, force=(0, 0, -2000.0))
            ),
            {"3450", "4250"},
        ),
        # a force P at 1/4 L: each once, though they last as far as the ends
        ("V", on_supports(tb.PointLoad(4, force=(0, 0, -800.0))), {"600", "-200"}),
        # two spans of l under q: 3/8 and 5/8 q l, to what shear leaves
        (
            "V",
            on_supports(tb.LineLoad(force=(0, 0, -1000.0)), inner=(8,)),
            {"1500", "-2500", "2500", "-1500"},
        ),
    ],
)
def test_values_stand_on_both_sides_of_a_jump(name, scene, values):
    """Each once, and none upon another."""
    ax = tb.plot.diagram(tb.equilibrium(scene), name, scene=scene)
    texts = [text.get_text() for text in ax.texts]
    assert set(texts) == values and len(texts) == len(values)
    ax.figure.canvas.draw()
    boxes = [text.get_window_extent() for text in ax.texts]
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])
    frame = ax.get_window_extent()
    assert all(frame.y0 < box.y0 and box.y1 < frame.y1 for box in boxes)


@pytest.mark.parametrize("size", [(10, 5.6), (4, 8)])
def test_diagrams_of_one_beam_line_up(size):
    """They share x, from end to end with little room, in wide pictures and in high ones."""
    scene = on_supports(tb.PointLoad(6, moment=(0, 800.0, 0)), tb.PointLoad(10, (0, 0, -400.0)))
    state, pictures = tb.equilibrium(scene), tb.plot.grid(2, 1, size=size)
    for name, ax in zip("VM", pictures, strict=True):
        tb.plot.diagram(state, name, ax, scene=scene, symbols=name == "M")
    pictures[0].figure.canvas.draw()
    (start, end), other = (ax.get_xlim() for ax in pictures)
    assert_close(other, (start, end))
    assert -1.2 < start < -0.2 and 8.2 < end < 9.2


def test_diagrams_in_space_have_axes_of_the_section():
    state = tb.equilibrium(
        scene := tb.Scene(tb.Beam.arc(1.0, 1.0, 2, SECTION, direction=(1, 1, 1)))
    )
    with pytest.raises(ValueError, match="F2, F3, M2 or M3"):
        tb.plot.diagram(state, "V", scene=scene)


@pytest.mark.parametrize("resultant", ["M", "V"])
def test_numbers_of_beams_that_meet_stand_once(resultant):
    """Two rafters under a force at the ridge: what both say there stands there once. Supports have
    the colour of the labels, also in a dark style.
    """
    plt = pytest.importorskip("matplotlib.pyplot")
    section = tb.Section.from_stiffness(EA=1e9, GA=1e9, GJ=1e4, EI=1e6, mass=1.0)
    parts = {"left": tb.Beam.straight(2.0, 4, section, direction=(1, 0, 0.05))}
    tip = parts["left"].nodes[-1].tolist()
    parts["right"] = tb.Beam.straight(2.0, 4, section, root=tip, direction=(1, 0, -0.05))
    scene = tb.Scene(
        parts,
        [tb.PointLoad(("left", -1), (0, 0, -1000.0))],
        joints=[tb.Weld(("left", -1), ("right", 0))],
        supports=[
            tb.Support(("left", 0), rotation="xz"),
            tb.Support(("right", -1), position="yz", rotation="xz"),
        ],
        plane="xz",
    )
    with plt.style.context("dark_background"):
        ax = tb.plot.diagram(tb.equilibrium(scene), resultant, scene=scene, symbols=True)
    numbers = [text.get_text() for text in ax.texts if "N" not in text.get_text()]
    assert len(numbers) == {"M": 1, "V": 2}[resultant]
    assert {line.get_markeredgecolor() for line in ax.lines if line.get_ls() == "None"} == {"white"}


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_diagram_of_nothing_is_the_axis(dtype):
    scene = tb.Scene(tb.Beam.straight(1.0, 4, SECTION), dtype=dtype)
    ax = tb.plot.diagram(tb.rest(scene), "M1", scene=scene, plane="xz")
    assert len(data(ax)) == 1 and [text.get_text() for text in ax.texts] == ["0"]


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
@pytest.mark.parametrize("resultant", ["F3", "M1", "M2"])
def test_diagram_of_what_rounding_leaves_is_the_axis(resultant, dtype):
    """Of a post that a force bends in a plane: nothing acts across it."""
    post = tb.Beam.straight(1.0, 4, SECTION, direction=(0.6, 0.0, 0.8), up=(0.0, 1.0, 0.0))
    scene = tb.Scene(post, [tb.LineLoad(force=(1e-3, 0, 0.002))], dtype=dtype)
    state = tb.equilibrium(scene)
    forces = tb.sensors.SectionForces(scene)(state)
    assert forces[..., 1].abs().max() > 1e-4
    ax = tb.plot.diagram(state, resultant, scene=scene)
    assert len(data(ax)) == 1 and [text.get_text() for text in ax.texts] == ["0"]


def test_diagram_of_bodies_alone_is_refused():
    parts = {name: tb.Body(mass=1.0, inertia=(1e-3,) * 3) for name in ("a", "b")}
    scene = tb.Scene(parts, joints=[tb.Hinge("a", "b")])
    with pytest.raises(ValueError, match="bodies alone were given to a diagram"):
        tb.plot.diagram(tb.rest(scene), "M2", scene=scene)


def test_diagram_of_a_frame(tmp_path):
    """Along each of its beams; a force across the plane that is seen is turned into it."""
    beams = {"post": tb.Beam.straight(1.0, 2, SECTION, direction=(0, 1, 0), up=(1.0, 0, 0))}
    beams["arm"] = tb.Beam.straight(0.5, 2, SECTION, root=(0, 1.0, 0))
    joints, weight = [tb.Weld(("post", -1), ("arm", 0))], tb.PointLoad(("arm", -1), (0, -1e-5, 0))
    scene = tb.Scene(beams, [weight], joints=joints, supports=[tb.Support(("post", 0))])
    state = tb.equilibrium(scene)
    ax = tb.plot.diagram(state, "F1", scene=scene, plane="xy")
    drawn(ax, tmp_path / "frame.png")
    assert [text.get_text() for text in ax.texts] == ["-1e-05", "0"]
    assert ax.get_xlabel() == "x / m" and ax.get_ylabel() == "y / m" and len(ax.get_yticks())
    reach = max((line[:, 0].max() - line[:, 0].min()).item() for line in data(ax)[:2])
    assert reach > 0.1
    ax = tb.plot.diagram(state, "M3", scene=scene, plane="xy", values=False)
    assert not ax.texts


def test_load_path(tmp_path):
    """Equilibria under a growing load: solid, dashed from where they are called unstable, up to the
    last valid one, a dot at the limit point; the pieces join.
    """
    states = [tb.equilibrium(tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, f))])) for f in range(8)]
    path = SimpleNamespace(
        factor=torch.arange(8.0), state=tb.State.stack(states), stable=torch.arange(8) < 4,
        valid=torch.arange(8) < 7, kind=(torch.arange(8) == 4).long(),
    )  # fmt: skip
    ax = tb.plot.load_path(path, tb.sensors.TipPosition()["z"], label="strip", name="force / N")
    drawn(ax, tmp_path / "path.png")
    solid, dashed, dot, *_ = data(ax)
    assert [line.get_linestyle() for line in ax.lines[:2]] == ["-", "--"] and (
        solid[-1] == dashed[0]
    ).all()
    assert_close(
        torch.cat((solid, dashed[1:])),
        torch.stack((path.state.tip.position[:7, 2], path.factor[:7]), -1),
    )
    assert_close(dot, dashed[1:2])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("tip position / m", "force / N")


def test_campbell(tmp_path):
    speed = torch.linspace(0, 30, 7)
    frequency = torch.stack((9 + 0.1 * speed, 40 - 0.2 * speed), -1)
    ax = tb.plot.campbell(speed, frequency, orders=(1, 2), names=("flap", "edge"))
    drawn(ax, tmp_path / "campbell.png")
    assert_close(data(ax)[1][:, 1], frequency[:, 1])
    ray = data(ax)[3]
    assert_close(ray[1, 1], 2 * ray[1, 0])


def test_animation(solution, tmp_path):
    """0.4 s at half speed and 10 pictures a second: 9 pictures that move, each with its time."""
    path = tb.plot.animate(
        solution, tmp_path / "motion.gif", fps=10, speed=0.5, dpi=50, frames=True
    )
    film = Image.open(path)
    assert film.n_frames == 9 and film.info["duration"] == 100
    pictures = []
    for k in (0, 4):
        film.seek(k)
        pictures.append(np.asarray(film.convert("L")).astype(float))
    assert 1e-3 < (abs(pictures[0] - pictures[1]) > 50).mean() < 0.2


def standing_ball():
    """A rod of known thickness on a ball that is a body, over a floor, with a tendon."""
    law = dict(radius=0.02, thickness=5e-3, force=50.0)
    parts = {
        "rod": tb.Beam.straight(1.0, 4, SECTION, root=(0, 0, 0.124)),
        "ball": tb.Body(0.1, 1e-3, position=(0.8, 0, 0)),
        "brick": tb.Body(
            0.1, 1e-3, position=(0.2, 0, 0), surface=tb.Box((0, 0, 0), (0.2,) * 3, 0.01)
        ),
    }
    effects = [
        tb.Contact("rod", "ball", other_radius=0.1, **law),
        tb.Contact("ball", tb.Plane((0, 0, -0.104), (0, 0, 1.0)), thickness=5e-3, force=50.0,
                   radius=0.1),
        tb.Tendon([(None, (0, 0, 0.3)), (("rod", -1), (0, 0, 0.05))], tension=0.1),
        tb.Gravity((0, 0, -9.81)),
    ]  # fmt: skip
    return tb.Scene(parts, effects, supports=[tb.Support(("rod", 0))])


def test_what_is_solid_is_as_large_as_it_is():
    """In a plane the outline of a rod is its radius away from its axis, and the pixels of a ball
    and a brick are solid; in space every corner of a facet is on a surface.
    """
    scene = standing_ball()
    state = tb.rest(scene)
    ax = tb.plot.shape(state, plane="xz", scene=scene)
    (rod,) = (torch.from_numpy(x.get_xy()) for x in ax.patches)
    assert_close((rod[:, 1] - 0.124).abs(), torch.full_like(rod[:, 1], 0.02), check_dtype=False)
    filled = [c.get_paths()[0] for c in ax.collections]
    points = [(0.8, 0.08), (0.8, -0.02), (0.2, 0.09), (0.6, -0.11), (0.5, 0.0), (0.8, 0.11)]
    inside = [any(path.contains_point(p) for path in filled) for p in points]
    assert inside == [True, True, True, True, False, False]
    ax = tb.plot.shape(state, tb.plot.axes(three=True), scene=scene)
    floor, solid = (torch.from_numpy(np.asarray(c._faces)) for c in ax.collections)
    assert_close(floor[..., 2].unique(), torch.tensor([-0.104]), check_dtype=False)
    x, y, z = solid.flatten(0, 1).double().T
    ball = (((x - 0.8) ** 2 + y**2 + z**2).sqrt() - 0.1).abs() < 1e-9
    rod = ((y**2 + (z - 0.124) ** 2).sqrt() - 0.02).abs() < 1e-9
    brick = ((torch.stack((x - 0.2, y, z)).abs().amax(0) - 0.1).abs() < 4e-3) & (x < 0.31)
    thread = (z - 0.3).hypot(x).minimum((z - 0.174).hypot(x - 1.0)) < 0.02
    assert (ball | rod | brick | thread).all()
    assert min(x.sum() for x in (ball, rod, brick, thread)) > 20


def test_a_node_that_touches_is_round():
    """A rod of 0.5 m and the radius 20 mm, in a structure: its last node is a ball, the first is
    not, nor are the other beam's.
    """
    section = tb.Section.circle(0.01, E=1e9, nu=0.3, rho=1e3)
    rods = {name: tb.Beam.straight(0.5, 2, section, (0, 0, 1)) for name in ("a", "b")}
    floor = tb.Plane((0, 0, -1.0), (0, 0, 1.0))
    touching = tb.Contact(floor, node=("b", -1), radius=0.02, thickness=1e-3, force=1.0)
    scene = tb.Scene(rods, [touching])
    ax = tb.plot.shape(tb.rest(scene), tb.plot.axes(three=True), scene=scene)
    *_, solid = (torch.from_numpy(np.asarray(c._faces)).flatten(0, 1) for c in ax.collections)
    x, y, z = solid.double().T
    assert z.min() > -1e-9
    assert_close(z.max(), torch.tensor(0.52, dtype=torch.float64), rtol=0, atol=1e-9)
    ball = z > 0.5 + 1e-9
    off = (x**2 + y**2 + (z - 0.5) ** 2).sqrt()[ball] - 0.02
    assert ball.sum() > 20 and off.abs().max() < 1e-9


@pytest.mark.parametrize("order", [1, 2])
def test_what_tapers_is_drawn_so(order):
    """By the radius of contacts at each place, of each sample its own, and by the section there:
    half of the outline's height above a straight axis.
    """
    s = torch.linspace(0, 1, 8 * 4 * order + 1)
    radii = tb.Table((0.0, 0.3, 1.0), torch.tensor([[0.02, 0.05, 0.01], [0.03, 0.03, 0.0]]))
    floor = tb.Contact(tb.Plane((0, 0, -1.0), (0, 0, 1.0)), radius=radii, thickness=1e-3, force=1.0)

    def section(s):
        return tb.Section.rectangle(width=0.03, height=0.02 + 0.08 * s, E=1e9, nu=0.3, rho=1e3)

    beam = tb.Beam.straight(1.0, 4, section, order=order)

    def heights(scene, state):
        ax = tb.plot.shape(state, plane="xz", scene=scene)
        outlines = [torch.from_numpy(x.get_xy())[:-1] for x in ax.patches]
        return torch.stack([x[: len(x) // 2, 1] for x in outlines])

    touching, free = tb.Scene(beam, [floor]), tb.Scene(beam)
    state = tb.rest(touching)
    assert_close(heights(touching, state), radii(s), check_dtype=False, rtol=1e-6, atol=1e-9)
    drawn = heights(free, tb.rest(free))
    wanted = 0.01 + 0.04 * (s[None] - s[None] % (1 / 4 / order) + 0.5 / 4 / order)
    assert (drawn - wanted)[:, :-1].abs().max() < 2e-3
    with pytest.raises(ValueError, match=r"a scene and a state with the batch axes \(2,\) and"):
        tb.plot.shape(state.map(lambda x: torch.stack([x[0]] * 3)), plane="xz", scene=touching)


@pytest.mark.parametrize("three", [False, True])
@pytest.mark.parametrize("own", [("x",), ("z",), ("x", "z")])
def test_limits_that_are_set_stay(own, three):
    """Of each coordinate by itself; the others have room for beams, bodies and tendons, not much
    more.
    """
    scene = standing_ball()
    ax = tb.plot.axes(three=three)
    if not three:
        own = ["y" if name == "z" else name for name in own]
    ax.set(**{f"{name}lim": (-0.5, 1.7) for name in own})
    tb.plot.shape(tb.rest(scene), ax, plane=None if three else "xz", scene=scene)
    reach = {"x": (0.0, 1.0), "y": (-0.1, 0.1), "z": (-0.1, 0.3)}
    for name in ("x", "y", "z") if three else ("x", "y"):
        low, high = getattr(ax, f"get_{name}lim")()
        first, last = reach["z" if name == "y" and not three else name]
        if name in own:
            assert (low, high) == (-0.5, 1.7)
        else:
            assert low <= first and last <= high and high - low < 1.6


@pytest.mark.parametrize("film", [False, True])
def test_a_picture_has_room_for_tendons(film, tmp_path):
    """That go beyond all beams and bodies, in some samples, without limits that are set."""
    eyelet = torch.tensor([[0.2, 0, 0.5], [-2.0, 0, 0.3]])
    tendon = tb.Tendon([(None, eyelet), (-1, (0, 0, 0.05))], tension=0.1)
    scene = tb.Scene(BEAM, [tendon])
    state, ax = tb.rest(scene), tb.plot.axes()
    if film:
        tb.plot.animate(state.map(lambda x: torch.stack([x, x])), tmp_path / "a.gif", ax,
                        plane="xz", scene=scene, dpi=40)  # fmt: skip
    else:
        tb.plot.shape(state, ax, plane="xz", scene=scene)
    assert ax.get_xlim()[0] < -2.0 and 0.5 < ax.get_ylim()[1] < 3.0


def test_a_film_of_what_is_solid(tmp_path):
    """Of a motion and of equilibria one after the other: it moves, within limits that are set; what
    is beside it is called with each place.
    """
    scene, places = standing_ball(), []
    run = tb.simulate(scene, torch.linspace(0, 0.02, 5), step=5e-3, engine="eager")
    ax = tb.plot.axes()
    ax.set(xlim=(-0.1, 1.2), ylim=(-0.3, 0.4))
    path = tb.plot.animate(run, tmp_path / "a.gif", ax, plane="xz", scene=scene, fps=10, speed=0.05,
                           dpi=40, beside=places.append)  # fmt: skip
    assert places == [0, 1, 2, 3, 4] and Image.open(path).n_frames == 5
    assert_close(
        torch.tensor([*ax.get_xlim(), *ax.get_ylim()]), torch.tensor([-0.1, 1.2, -0.3, 0.4])
    )
    loads = torch.tensor([0.0, 0.5, 1.0])[:, None] * torch.tensor([0.0, 0, 1])
    bent = tb.Scene(BEAM, [tb.TipLoad(force=loads)])
    film = tb.plot.animate(tb.equilibrium(bent), tmp_path / "b.gif", scene=bent, dpi=40)
    assert Image.open(film).n_frames == 3
    for wrong, said in ((tb.rest(SCENE), "a State of one sample"), (1.0, "float")):
        with pytest.raises(
            ValueError, match=f"{said} was given to animate; a Solution, or a State"
        ):
            tb.plot.animate(wrong, tmp_path / "c.gif")


def test_what_has_no_form_is_left_out(tmp_path):
    """An obstacle of one's own in space; a body that touches nothing is a mark."""

    @dataclass(frozen=True)
    class Ball(extend.Obstacle):
        centre: extend.Value = extend.leaf(1)
        PLACE = "centre"

        def distance(self, x):
            return (x - self.centre).norm(dim=-1, keepdim=True) - 0.1

        def gradient(self, x):
            return torch.nn.functional.normalize(x - self.centre, dim=-1)

    law = dict(thickness=0.01, force=1.0)
    effects = [tb.Contact("rod", Ball((0.5, 0, -0.3)), **law)]
    tube = tb.Cylinder((0, 0, 0), (1.0, 0, 0), 0.1, inside=True)
    effects.append(tb.Contact("rod", tube, **law))
    scene = tb.Scene({"rod": BEAM, "hub": tb.Body(0.1, 1e-3, position=(0.3, 0, 0.1))}, effects)
    for plane in (None, "xz"):
        ax = tb.plot.axes(three=plane is None)
        tb.plot.save(
            tb.plot.shape(tb.rest(scene), ax, plane=plane, scene=scene), tmp_path / "a.png"
        )
        assert len(ax.collections) == 2 and [line.get_marker() for line in ax.lines] == ["s"]


def test_what_spins_shows_it():
    """A drum's line is where its spin has brought it."""
    drum = tb.Contact(
        tb.Cylinder((0.5, 0, -0.3), (0, 1.0, 0), 0.2, spin=3.0), thickness=0.01, force=1.0
    )
    scene = tb.Scene(BEAM, [drum])
    ax = tb.plot.axes()
    ax.set(xlim=(0, 1), ylim=(-0.6, 0.1))
    tb.plot.shape(tb.rest(scene, t=0.5), ax, plane="xz", scene=scene)
    (line,) = data(ax)
    turned = torch.tensor([[0.5, -0.3], [0.5 + 0.2 * math.cos(1.5), -0.3 - 0.2 * math.sin(1.5)]])
    assert_close(line, turned, check_dtype=False)


def test_animation_as_mp4(solution, tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    path = tb.plot.animate(solution, tmp_path / "motion.mp4", fps=10, plane="xz", dpi=50)
    assert path.read_bytes()[4:8] == b"ftyp" and path.stat().st_size > 2000


# fmt: off
CASES = {
    "solution for a state": (lambda s: tb.plot.shape(s),
                             "Solution was given to a picture of the beam; a state"),
    "unknown plane": (lambda s: tb.plot.shape(s.state, plane="zx"), "plane = 'zx' was given"),
    "flat axes": (lambda s: tb.plot.shape(tb.rest(ROUND), tb.plot.axes()), "flat axes were given"),
    "many samples": (lambda s: tb.plot.mode_shapes(s.state, tb.modes(tb.Scene(BEAM), count=1)),
                     "one sample is wanted"),
    "samples for a diagram": (lambda s: tb.plot.diagram(s.state, "M2", scene=SCENE),
                              "9 samples were given to a diagram; one sample is wanted"),
    "another resultant": (lambda s: tb.plot.diagram(s.state[0], "M4", scene=SCENE),
                          "resultant = 'M4' was given"),
    "flat frequencies": (lambda s: tb.plot.campbell(torch.zeros(2), torch.zeros(2)),
                         r"\(n,\) and \(n, count\)"),
    "another file": (lambda s: tb.plot.animate(s, "motion.avi"), "one that ends in .gif or .mp4"),
    "no pictures": (lambda s: tb.plot.animate(s, "motion.gif", fps=0.0), "fps = 0.0 was given"),
}
# fmt: on


@refusals(CASES)
def test_refused(call, solution):
    call(solution)


def writers(solution):
    return (
        lambda path: tb.plot.save(
            tb.plot.history(solution, tb.sensors.TipPosition()), path.with_suffix(".png")
        ),
        lambda path: tb.plot.animate(solution, path.with_suffix(".gif"), fps=5, dpi=30),
    )


def test_where_pictures_go(solution, tmp_path):
    """The file's folder is made; one whose own folder is missing, or a file, is refused in a
    sentence, and nothing is made.
    """
    (tmp_path / "file").write_text("")
    for k, write in enumerate(writers(solution)):
        assert write(tmp_path / f"new {k}" / "picture").exists()
        for folder, sentence in (
            ("no/such", "no' is no folder; one in a folder"),
            ("file/x", "file' is no folder"),
            ("file", "was given for a folder"),
        ):
            with pytest.raises(ValueError, match=sentence):
                write(tmp_path / folder / "picture")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "new 0", "new 1"]
    with pytest.raises(ValueError, match=r"the file 'picture' was given; one that ends in .png"):
        tb.plot.save(tb.plot.axes(), tmp_path / "picture")
    with pytest.raises(ValueError, match="xyz"):
        tb.plot.save(tb.plot.axes(), tmp_path / "picture.xyz")


def test_a_list_of_axes_is_one_picture(tmp_path):
    """As `grid`, `fit` and matplotlib's own functions give them; not an empty one."""
    assert tb.plot.save(tb.plot.grid(1, 2), tmp_path / "two.png").exists()
    with pytest.raises(ValueError, match=r"ax = \[\] was given"):
        tb.plot.save([], tmp_path / "none.png")


def test_pictures_are_drawn_where_pyplot_shows_them(solution):
    """In axes of pyplot's, for a window."""
    plt = pytest.importorskip("matplotlib.pyplot")
    figure, own = plt.subplots()
    try:
        assert tb.plot.shape(solution.state[-1], own) is plt.gca() and own.lines
    finally:
        plt.close(figure)


def test_a_picture_is_whole_or_as_it_was(solution, tmp_path, monkeypatch):
    """A full disk: one sentence, the picture of before, and no other file."""

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    for write in writers(solution):
        path = write(tmp_path / "picture")
        before = path.read_bytes()
        with monkeypatch.context() as patch:
            patch.setattr(os, "fsync", full)
            with pytest.raises(
                OSError, match=f"{path.name}' could not be written: No space left on device"
            ):
                write(tmp_path / "picture")
        assert path.read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ["picture.gif", "picture.png"]


def test_without_matplotlib(solution, monkeypatch):
    """One sentence that names the extra."""
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ImportError, match=r"pip install 'torchbeam\[plot\]'"):
        tb.plot.shape(solution.state)


def test_obstacles_are_drawn_where_they_are(tmp_path):
    """A ball beside a floor: the pixels of the picture's cut that are solid, and those that are
    not; refused in space.
    """
    law = dict(thickness=0.01, force=1.0)
    contacts = [
        tb.Contact(tb.Plane((0, 0, -0.4), (0, 0, 1.0)), **law),
        tb.Contact(tb.Sphere((0.5, 0, 0.3), 0.1), **law),
    ]
    scene = tb.Scene(BEAM, contacts)
    ax = tb.plot.shape(tb.rest(scene), plane="xz")
    ax.set(xlim=(0.0, 1.0), ylim=(-0.6, 0.6))
    before = len(ax.collections)
    tb.plot.obstacles(scene, ax, plane="xz")
    floor, ball = ax.collections[before:]
    inside = [
        any(path.contains_point(at) for path in one.get_paths())
        for one, at in ((floor, (0.2, -0.5)), (floor, (0.2, -0.3)), (ball, (0.5, 0.35)))
    ]
    assert inside == [True, False, True]
    tb.plot.save(ax, tmp_path / "ball.png")
    with pytest.raises(ValueError, match="three-dimensional"):
        tb.plot.obstacles(scene, tb.plot.axes(three=True), plane="xz")


@pytest.mark.parametrize("name", ["shape", "history", "load_path", "tendons"])
def test_lines_are_as_a_user_wants_them(name, solution):
    """By any of matplotlib's names, in the place of what is usual."""
    scene = tb.Scene(BEAM, [tb.Tendon.along(BEAM, (0, 0, 0.1), tension=1.0)])
    tip = tb.sensors.TipPosition()["z"]
    states, yes = solution.state, torch.ones(9).bool()
    path = SimpleNamespace(
        factor=torch.arange(9.0), state=states, stable=yes, valid=yes, kind=0 * yes
    )
    draw = {
        "shape": lambda **line: tb.plot.shape(states[-1], **line),
        "history": lambda **line: tb.plot.history(solution, tip, **line),
        "load_path": lambda **line: tb.plot.load_path(path, tip, **line),
        "tendons": lambda **line: tb.plot.tendons(
            scene, tb.rest(scene), tb.plot.axes(), plane="xz", **line
        ),
    }[name]
    for line in (dict(lw=3, ls=":"), dict(linewidth=3, linestyle=":")):
        first = draw(**line, color="C3").lines[0]
        assert (first.get_linewidth(), first.get_linestyle(), first.get_color()) == (3, ":", "C3")


def test_tendons_are_drawn_where_their_eyelets_are(tmp_path):
    """Of two samples, dashed, in a plane and in space; refused without tendons or a plane."""
    pulls = torch.tensor([0.0, 1.0])
    scene = tb.Scene(BEAM, [tb.Tendon.along(BEAM, (0, 0, 0.1), tension=pulls)])
    state = tb.rest(scene)
    for plane, seen in (("xz", [0, 2]), (None, [0, 1, 2])):
        ax = tb.plot.shape(state, tb.plot.axes(three=plane is None), plane=plane)
        before = len(ax.lines)
        tb.plot.tendons(scene, state, ax, plane=plane)
        (line, *_) = drawn = ax.lines[before:]
        assert len(drawn) == len(state.position.reshape(-1, *state.position.shape[-2:]))
        assert line.get_linestyle() == "--" and line.get_marker() == "o"
        places = line.get_data_3d() if plane is None else line.get_data()
        eyelets = scene.tendons[0].at(state.position, state.rotation)
        eyelets = eyelets.reshape(-1, len(places[0]), 3)[0]
        assert_close(torch.tensor([*map(list, places)]).mT, eyelets[:, seen], check_dtype=False)
        tb.plot.save(ax, tmp_path / "tendons.png")
    with pytest.raises(ValueError, match="plane = None"):
        tb.plot.tendons(scene, state, tb.plot.axes())
    with pytest.raises(ValueError, match="without tendons"):
        tb.plot.tendons(tb.Scene(BEAM), state, ax)
