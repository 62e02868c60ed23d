"""Symbols of supports, joints and loads, reactions, and magnified displacements: where they are,
which way they point, and what their numbers say.
"""

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.unit.plot.test_plot import data, drawn
from torchbeam.plot.arrows import ROW
from torchbeam.plot.symbols import LOAD

pytest.importorskip("matplotlib")
SECTION = tb.Section.rectangle(width=0.03, height=0.02, E=69e9, nu=0.33, rho=2700.0)
BEAM = tb.Beam.straight(1.0, 4, SECTION)
LOADS = [
    tb.TipLoad(force=(0, 0, -20.0)),
    tb.LineLoad(force=(0, 0, -30.0)),
    tb.PointLoad(2, moment=(0, 5.0, 0)),
]


@pytest.mark.parametrize("elements", [4, 9, 12, 16, 17])
def test_arrows_of_an_even_load_are_evenly_apart(elements):
    """The last gap, to the end of the beam, may be shorter; 30,000 N/m without an exponent."""
    beam = tb.Beam.straight(1.0, elements, SECTION)
    scene = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -3e4))])
    ax = tb.plot.shape(tb.rest(scene), plane="xz", scene=scene, symbols=True)
    heads = sorted(
        {
            round(line.get_xdata()[1], 6)
            for line in ax.lines
            if len(line.get_xdata()) == 3 and line.get_color() == LOAD
        }
    )
    gaps = np.diff(heads)
    assert len(heads) <= ROW + 1 and gaps[-1] <= gaps[0] + 1e-9
    np.testing.assert_allclose(gaps[:-1], gaps[0], rtol=1e-5)
    assert "30,000 N/m" in texts(ax)


def texts(ax):
    return sorted(text.get_text() for text in ax.texts)


def ink_about(ax, x, y, reach=16):
    """Dark pixels left, right, below and above a point, but for a cross through it: of a symbol."""
    canvas = ax.figure.canvas
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].max(-1) < 170
    column, row = ax.transData.transform((x, y)).round().astype(int)
    row = pixels.shape[0] - row
    near = pixels[row - reach : row + reach + 1, column - reach : column + reach + 1]
    side = reach - 2
    return [
        int(part.sum()) for part in (near[:, :side], near[:, -side:], near[-side:], near[:side])
    ]


LEFT, RIGHT, BELOW, ABOVE = range(4)


@pytest.mark.parametrize(
    ("node", "held", "side"),
    [
        (0, ("xyz", "xyz"), LEFT),
        (-1, ("xyz", "xyz"), RIGHT),
        (0, ("xyz", "xz"), BELOW),
        (-1, ("yz", "xz"), BELOW),
        (0, ("xy", "xz"), LEFT),
        (-1, ("xy", "xz"), RIGHT),
        (0, ("xy", "xyz"), LEFT),
        (2, ("yz", "xyz"), BELOW),
    ],
)
def test_the_ground_of_a_support_lies_beyond_the_beam_or_below(node, held, side):
    """By what it holds in the plane that is seen, whichever way the beam goes from there."""
    scene = tb.Scene(BEAM, supports=[tb.Support(node, *held)], plane="xz")
    ax = tb.plot.axes()
    ax.set(xlim=(-0.5, 1.5), ylim=(-0.7, 0.7))
    tb.plot.symbols(tb.rest(scene), ax, scene=scene, plane="xz")
    ax.set_axis_off()
    ink = ink_about(ax, BEAM.nodes[node, 0], 0.0)
    other = {LEFT: RIGHT, RIGHT: LEFT, BELOW: ABOVE, ABOVE: BELOW}[side]
    assert ink[side] > 20 and ink[other] == 0


def test_supports_differ_by_what_they_hold():
    """As many pictures as kinds, each symbol once; nothing where nothing is held in the plane."""
    kinds = [("xyz", "xyz"), ("xyz", "xz"), ("yz", "xz"), ("yz", "xyz"), ("", "y"), ("y", "xz")]
    paths = []
    for held in kinds:
        scene = tb.Scene(BEAM, supports=[tb.Support(2, *held)], small=True)
        ax = tb.plot.symbols(tb.rest(scene), scene=scene, plane="xz")
        paths.append([len(line.get_marker().vertices) for line in ax.lines])
    assert paths[-1] == [] and all(len(path) == 1 for path in paths[:-1])
    assert len({path[0] for path in paths[:-1]}) == 5


@pytest.mark.parametrize("order", [1, 2])
def test_loads_have_their_numbers(order, tmp_path):
    """Of a force, a moment and an even load, at a state with any bend."""
    scene = tb.Scene(tb.Beam.straight(1.0, 4, SECTION, order=order), LOADS)
    state = tb.equilibrium(scene)
    ax = tb.plot.shape(state, scene=scene, symbols=True, plane="xz")
    drawn(ax, tmp_path / "loads.png")
    assert texts(ax) == ["20 N", "30 N/m", "5 N m"]
    at = state.tip.position[[0, 2]]
    tail = at + torch.tensor([0.0, 1.0]) * (at - data(ax)[0][0]).norm()
    assert_close(data(ax)[0], torch.stack((tail, at)))  # the shaft of the force: it pushes down


def test_a_mass_weighs_on_its_node():
    """Not along the elements beside it: the beam's own weight is even."""
    mass = tb.PointMass(2.0, node=-1)
    scene = tb.Scene(BEAM, [tb.Gravity((0, 0, -10.0)), mass])
    ax = tb.plot.symbols(tb.rest(scene), scene=scene, plane="xz")
    assert texts(ax) == ["16.2 N/m", "20 N"]


def test_a_moment_turns_as_it_is_seen():
    """About y, in x-z with x to the right: clockwise, from z to x; against it if negative."""
    for value, turn in ((5.0, -1), (-5.0, 1)):
        scene = tb.Scene(BEAM, [tb.PointLoad(2, moment=(0, value, 0))])
        ax = tb.plot.symbols(tb.rest(scene), scene=scene, plane="xz")
        ring = data(ax)[0] - torch.tensor([0.5, 0.0])
        area = ring[:-1, 0] * ring[1:, 1] - ring[:-1, 1] * ring[1:, 0]
        assert (area * turn > 0).all() and texts(ax) == ["5 N m"]


def test_a_force_along_the_beam_pulls_from_its_node():
    """Or pushes at it, from where there is no beam; beside a lever it acts at its own place."""
    for load, shaft in (
        (tb.TipLoad(force=(7.0, 0, 0)), ((1.0, 0), (1.16, 0))),
        (tb.TipLoad(force=(-7.0, 0, 0)), ((1.16, 0), (1.0, 0))),
        (tb.TipLoad(force=(0, 0, -7.0), offset=(0.1, 0, 0)), ((1.1, 0.16), (1.1, 0))),
        (tb.TipLoad(force=tb.Input("F", 3)), ((1.0, -0.16), (1.0, 0))),
    ):
        scene = tb.Scene(BEAM, [load])
        given = {"F": (0, 0, 7.0)} if scene.inputs else None
        ax = tb.plot.symbols(tb.rest(scene), scene=scene, plane="xz", inputs=given)
        assert_close(data(ax)[0], torch.tensor(shaft)) and texts(ax) == ["7 N"]
    with pytest.raises(ValueError, match="the input 'F' is missing"):
        tb.plot.symbols(tb.rest(scene), scene=scene, plane="xz")


def frame(order=1):
    parts = {
        "post": tb.Beam.straight(
            0.5, 2, SECTION, direction=(0, 0, 1), up=(-1.0, 0, 0), order=order
        ),
        "arm": tb.Beam.straight(1.0, 4, SECTION, root=(0, 0, 0.5), order=order),
    }
    return tb.Scene(
        parts,
        [tb.LineLoad(force=(0, 0, -40.0), on="arm"), tb.Spring(("arm", 2), 1e3, (0.5, 0, 0.1))],
        joints=[tb.Hinge(("post", -1), ("arm", 0))],
        supports=[tb.Support(("post", 0)), tb.Support(("arm", -1), "yz", "xz")],
        plane="xz",
    )


@pytest.mark.parametrize("three", [False, True])
def test_symbols_of_a_frame(three, tmp_path):
    """A load along one of its beams alone, a spring from its point to its node, a ring at the
    hinge.
    """
    scene = frame()
    state = tb.equilibrium(scene)
    ax = tb.plot.shape(state, tb.plot.axes((6, 4), three=three), scene=scene, symbols=True)
    drawn(ax, tmp_path / "frame.png")
    assert texts(ax) == ["40 N/m"]
    seen = [0, 1, 2] if three else [0, 2]
    ends = [torch.stack((line[0], line[-1])) for line in data(ax) if len(line) > 1]
    spring = torch.stack((torch.tensor([0.5, 0, 0.1]), state["arm"].position[2]))[:, seen]
    assert any((x - spring).abs().max() < 1e-9 for x in ends)
    rings = [
        line for line, at in zip(ax.lines, data(ax), strict=True) if line.get_marker() == "o"
        and (at[0] - state["arm"].position[0, seen]).norm() < 1e-9
    ]  # fmt: skip
    assert len(rings) == 1


def test_joints_by_what_they_leave():
    """A hinge a ring, with a cross of two axes, a dot of a ball; rails along a slider; two rings
    of a distance; nothing where all is held.
    """
    meets = ("a", -1), ("b", 0)
    beams = {"a": BEAM, "b": tb.Beam.straight(1.0, 4, SECTION, root=(1.0, 0, 0))}
    rails = 0.05 * 2.0
    for joint, marks in (
        (tb.Weld(*meets), []),
        (tb.Hinge(*meets), ["o"]),
        (tb.Universal(*meets, axis=(0, 1, 0), second=(0, 0, 1)), ["o", "x"]),
        (tb.Ball(*meets), ["o", "."]),
        (tb.Slider(*meets), []),
        (tb.Distance(("a", -1), ("b", -1)), ["o"]),
    ):
        scene = tb.Scene(beams, joints=[joint], supports=[tb.Support(("a", 0), "", "")])
        ax = tb.plot.symbols(tb.rest(scene), scene=scene, plane="xz")
        assert [x.get_marker() for x in ax.lines if x.get_marker() != "None"] == marks
        long = [x for x in data(ax) if ((x[-1] - x[0]).norm() - 2 * rails).abs() < 1e-9]
        assert len(long) == (2 if isinstance(joint, tb.Slider) else 0)


def test_reactions_are_in_balance_with_the_loads(tmp_path):
    """Of a beam on two supports: half of the load each; a cantilever: the load and its moment."""
    ends = [tb.Support(0, rotation="xz"), tb.Support(-1, "yz", "xz")]
    scene = tb.Scene(BEAM, [tb.LineLoad(force=(0, 0, -30.0))], supports=ends, small=True)
    ax = tb.plot.reactions(tb.equilibrium(scene), scene=scene, plane="xz")
    drawn(ax, tmp_path / "reactions.png")
    assert texts(ax) == ["15 N", "15 N"]
    scene = tb.Scene(BEAM, LOADS, small=True)
    state = tb.equilibrium(scene)
    ax = tb.plot.shape(state, plane="xz", nodes=False)
    assert tb.plot.reactions(state, ax, scene=scene, plane="xz") is ax
    assert texts(ax) == ["40 N m", "50 N"]  # 20 + 30/2 + 5; 20 + 30
    assert_close(data(ax)[1][:, 1].diff(), torch.tensor([0.16]), atol=1e-4, rtol=0)  # from below
    assert (tb.plot.reactions(state, scene=scene).name, len(ax.lines)) == ("rectilinear", 7)


def test_reactions_of_one_state():
    many = tb.Scene(BEAM, [tb.TipLoad(force=torch.rand(3, 3))])
    with pytest.raises(ValueError, match="3 samples and the reactions of 1 supports was given"):
        tb.plot.reactions(tb.equilibrium(many), scene=many)
    free = tb.Scene(BEAM, supports=[])
    assert not tb.plot.reactions(tb.rest(free), scene=free, plane="xz").texts


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("solid", [False, True])
def test_displacements_times_many(order, solid):
    """About the undeformed beam: nodes exactly, between them along the magnified deflection curve,
    f (6 s^2 - 4 s^3 + s^4)/(24 EI) of an even load.
    """
    beam = tb.Beam.straight(1.0, 8, SECTION, order=order)
    scene = tb.Scene(beam, [tb.LineLoad(force=(0, 0, -30.0))], small=True)
    state = tb.equilibrium(scene)
    ax = tb.plot.shape(state, plane="xz", magnify=50.0, scene=scene if solid else None)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [
        "undeformed", "displacements times 50",
    ]  # fmt: skip
    if solid:
        (outline,) = (torch.from_numpy(x.get_xy()) for x in ax.patches)
        assert_close(outline[:, 1].min(), 50 * state.tip.position[2] - 0.01, atol=1e-3, rtol=0)
        return
    rest, _, curve, dots = data(ax)
    assert rest[:, 1].abs().max() == 0
    nodes = beam.nodes + 50 * (state.position - beam.nodes)
    assert_close(dots, nodes[:, [0, 2]])
    s = curve[:, 0]
    EI = 69e9 * 0.03 * 0.02**3 / 12
    exact = -50 * 30.0 * (6 * s**2 - 4 * s**3 + s**4) / (24 * EI)
    assert (curve[:, 1] - exact).abs().max() < 0.01 * exact.abs().max()


def test_undeformed_beams_of_structures_and_batches():
    scene = frame()
    ax = tb.plot.shape(tb.equilibrium(scene), undeformed=True, color="k")
    line = data(ax)[0]
    beam = scene.beam.nodes[:, [0, 2]]
    apart = (line[:, None] - beam).norm(dim=-1).nan_to_num(1.0).amin(0)
    assert apart.max() < 1e-12 and ax.get_legend() is not None
    loads = torch.tensor([0.5, 1.0])[:, None] * torch.tensor([0.0, 0, 1])
    many = tb.equilibrium(tb.Scene(BEAM, [tb.TipLoad(force=loads)]))
    assert len(tb.plot.shape(many, magnify=2.0, nodes=False).lines) == 4
    for state in (many.map(lambda x: x[..., :3, :] if x.ndim > 2 else x), SECTION):
        with pytest.raises(ValueError, match="given"):
            tb.plot.shape(state, magnify=2.0)
    with pytest.raises(ValueError, match="symbols=True without a scene was given; scene="):
        tb.plot.shape(many, symbols=True)


def test_bodies_alone_have_symbols():
    """A ball under its weight, held by a hinge on the ground, which stands for a support."""
    ball = {"ball": tb.Body(2.0, 1e-3, position=(1.0, 0, 0))}
    hinge = tb.Hinge(None, ("ball", (-1.0, 0, 0)))
    loads = [tb.Gravity((0, 0, -9.81)), tb.PointLoad("ball", (0, 0, 3.0))]
    scene = tb.Scene(ball, loads, joints=[hinge])
    ax = tb.plot.symbols(tb.rest(scene), scene=scene, plane="xz")
    assert "3 N" in texts(ax)
    assert any((at[0]).norm() < 1e-12 for at in data(ax))


def test_section_axes_are_named_where_they_are_seen():
    assert texts(tb.plot.shape(tb.rest(tb.Scene(BEAM)), plane="xz", frames=True)) == ["x", "z"]
    three = tb.plot.shape(tb.rest(tb.Scene(BEAM)), tb.plot.axes(three=True), frames=True)
    assert texts(three) == ["x", "y", "z"]


def test_diagram_with_symbols():
    scene = frame(order=2)
    ax = tb.plot.diagram(tb.equilibrium(scene), "M2", scene=scene, symbols=True, values=False)
    assert texts(ax) == ["40 N/m"] and math.isfinite(ax.get_ylim()[0])
