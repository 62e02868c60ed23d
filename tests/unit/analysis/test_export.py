"""export: what ParaView reads is what was written."""

import base64
from collections import Counter
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import torch

import torchbeam as tb
from torchbeam.plot.obstacles import standing
from torchbeam.scene import effects
from torchbeam.scene.effects import Obstacle

DTYPES = {"Float64": "<f8", "Int64": "<i8", "UInt8": "u1"}


def section():
    return tb.Section.from_stiffness(
        EA=100.0, GA=50.0, GJ=0.8, EI=(1.0, 2.0), mass=0.2, inertia=1e-3
    )


def scene(order=1, force=(0.1, 0.3, 0.2)):
    beam = tb.Beam.straight(1.0, 2, section(), order=order)
    return tb.Scene(beam, [tb.TipLoad(force=force)])


def read(path):
    """Arrays of a .vtu file by name, as VTK's format says."""
    found = {}
    for array in ElementTree.parse(path).iter("DataArray"):
        data = base64.b64decode(array.text)
        values = np.frombuffer(data[8:], DTYPES[array.get("type")])
        assert int.from_bytes(data[:8], "little") == values.nbytes
        width = int(array.get("NumberOfComponents"))
        found[array.get("Name")] = values if width == 1 else values.reshape(-1, width)
    piece = next(ElementTree.parse(path).iter("Piece"))
    assert len(found["points"]) == int(piece.get("NumberOfPoints"))
    assert len(found["types"]) == len(found["offsets"]) == int(piece.get("NumberOfCells"))
    return found


def same(x, y):
    return np.array_equal(x, torch.as_tensor(y).reshape(x.shape).numpy())


def test_a_motion_is_a_file_for_each_instant(tmp_path):
    """Of a batch, all samples in each."""
    force = torch.tensor([[0.1, 0.3, 0.2], [0.0, -0.5, 0.2]])
    solution = tb.simulate(scene(force=force), torch.linspace(0, 0.1, 3), step=0.05)
    assert tb.export(solution, tmp_path / "run.pvd") == tmp_path / "run.pvd"
    sets = list(ElementTree.parse(tmp_path / "run.pvd").iter("DataSet"))
    assert [float(one.get("timestep")) for one in sets] == solution.t.tolist()
    for i, one in enumerate(sets):
        found, state = read(tmp_path / one.get("file")), solution.state[i]
        assert same(found["points"], state.position) and same(found["velocity"], state.velocity)
        assert same(found["connectivity"], [0, 1, 1, 2, 3, 4, 4, 5])
        assert same(found["offsets"], [2, 4, 6, 8]) and same(found["types"], [3] * 4)
        assert same(found["sample"], [0, 0, 1, 1])
        assert same(found["force"], state.stress[..., :3])
        assert same(found["moment"], state.stress[..., 3:])
        axes = np.stack([found[name] for name in "xyz"], -1).reshape(2, 3, 3, 3)
        spin = axes @ state.spin.numpy()[..., None]
        assert np.abs(found["angular velocity"] - spin.reshape(-1, 3)).max() < 1e-14
        assert np.abs(axes - state.axes.numpy()).max() < 1e-15


def test_halves_of_elements_of_order_2_have_their_own_stress(tmp_path):
    state = tb.equilibrium(scene(order=2))
    found = read(tb.export(state, tmp_path / "shape.vtu"))
    assert same(found["points"], state.position) and len(found["types"]) == 4
    assert same(found["moment"], state.stress[..., 3:])


def test_parts_of_structures(tmp_path):
    """Beams as lines of their own stations, a body, behind them, as a vertex."""
    parts = {
        "a": tb.Beam.straight(1.0, 2, section()),
        "ball": tb.Body(0.1, 1e-3, position=(1.0, 0, 0)),
        "b": tb.Beam.straight(1.0, 1, section(), root=(1.0, 0, 0)),
    }
    joints = [tb.Weld(("a", 2), "ball"), tb.Hinge(("b", 0), "ball")]
    structure = tb.Scene(parts, joints=joints, supports=[tb.Support(("a", 0))])
    found = read(tb.export(structure, tmp_path / "shape.vtu"))
    assert same(found["connectivity"], [0, 1, 1, 2, 3, 4, 5])
    assert same(found["types"], [3, 3, 3, 1]) and same(found["part"], [0, 0, 1, 2])
    assert same(found["points"], structure.beam.nodes)
    state = tb.equilibrium(
        tb.Scene(
            parts,
            [tb.Gravity((0, 0, -1.0))],
            joints=[tb.Weld(("a", 2), "ball"), tb.Weld(("b", 0), "ball")],
            supports=[tb.Support(("a", 0))],
        )
    )
    found = read(tb.export(state, tmp_path / "shape.vtu"))
    assert same(found["force"][:3], state.stress[:3, :3])
    assert np.isnan(found["force"][3]).all()


def test_bodies_alone(tmp_path):
    """Vertices, without a force: of a scene, a batch of states, a motion and modes."""
    body = tb.Body(0.1, 1e-3, position=[[0.0, 0, 1.0], [0, 0, 2.0]])
    of = tb.Scene({"a": body}, joints=[tb.Hinge(None, "a", (0, 1, 0), stiffness=1.0)])
    state = tb.equilibrium(of)
    solution = tb.simulate(of, [0.0, 0.1], step=0.1)
    files = [
        tb.export(of, tmp_path / "drawn.vtu"),
        tb.export(state, tmp_path / "state.vtu"),
        tb.export(tb.modes(of, state, count=1), tmp_path / "modes.vtu", state=state),
        *(tb.export(solution, tmp_path / "run.pvd").with_suffix("").iterdir()),
    ]
    assert len(files) == 5
    for file in files:
        found = read(file)
        assert same(found["points"], of.beam.nodes) and same(found["types"], [1, 1])
        assert np.isnan(found["force"]).all() and same(found["sample"], [0, 1])


def test_modes_are_vectors_to_warp_by(tmp_path):
    """Real, along the mode, the largest displacement 1; of a torsional mode the largest turn."""
    still = tb.equilibrium(scene(force=(0.0, 0, 0)))
    modes = tb.modes(scene(force=(0.0, 0, 0)), still, count=6)
    found = read(tb.export(modes, tmp_path / "modes.vtu", state=still))
    for k, shape in enumerate(modes.shape, 1):
        moved, turned = (found[f"mode {k} {name}"] for name in ("displacement", "turn"))
        assert max(np.abs(moved).max(), np.abs(turned).max() * (np.abs(moved).max() < 1e-9)) == (
            pytest.approx(1)
        )
        along = np.concatenate((moved, turned), -1).reshape(-1)
        wanted = shape.reshape(-1).numpy()
        cosine = abs(np.vdot(wanted, along)) / np.linalg.norm(wanted) / np.linalg.norm(along)
        assert cosine == pytest.approx(1, abs=1e-9)


def test_bad_input(tmp_path):
    state = tb.rest(scene())
    modes = tb.modes(scene(force=(0.0, 0, 0)), state, count=2)
    solution = tb.simulate(scene(), torch.linspace(0, 0.1, 2), step=0.1)
    mixed = tb.Solution(solution.t, tb.consistent_state(scene())[None], lambda: None, tb.Stats())
    for what, name, given, message in (
        (state, "run.pvd", {}, "one that ends in .vtu or .glb is wanted"),
        (solution, "run.vtu", {}, "one that ends in .pvd or .glb is wanted"),
        (3, "run.vtu", {}, "int was given to export"),
        (state, "a/b/c.vtu", {}, "folder"),
        (mixed, "run.pvd", {}, "a Solution of MixedState"),
        (modes, "run.vtu", {}, "Modes without a state"),
        (solution, "run.pvd", dict(state=state), "Solution with a state"),
        (modes, "run.vtu", dict(state=tb.rest(scene(order=2))), "modes of 3 nodes"),
    ):
        with pytest.raises(ValueError, match=message):
            tb.export(what, tmp_path / name, **given)
    assert not list(tmp_path.iterdir())


SOLIDS = {
    "plane": tb.Plane((0.1, 0.2, -0.3), (0.0, 1.0, 2.0)),
    "moving plane": tb.Plane(lambda t: torch.stack((t, 0 * t, -t), -1), (0.0, 0, 1.0)),
    "sphere": tb.Sphere((0.6, 0.0, -0.25), 0.1),
    "cylinder": tb.Cylinder((0.3, 0.0, -0.4), (0.0, 1.0, 0.5), 0.1),
    "tube": tb.Cylinder((0.5, 0.0, 0.0), (1.0, 0.0, 0.0), 0.5, inside=True),
    "capsule": tb.Capsule((0.2, -0.5, -0.4), (0.2, 0.6, -0.3), 0.1),
    "box": tb.Box((0.5, 0.1, -0.4), (0.4, 0.5, 0.2), 0.05, rotation=(0.1, 0.3, 0.2)),
}


def test_every_obstacle_has_its_surface():
    public = (x for x in vars(effects).values() if isinstance(x, type) and issubclass(x, Obstacle))
    assert {type(x) for x in SOLIDS.values()} == {*public} - {Obstacle}


def closed(points, quads):
    """Whether a surface has no hole: points that are one place are one corner."""
    _, corner = np.unique(np.round(points.numpy(), 9), axis=0, return_inverse=True)
    ends = corner.reshape(-1)[np.stack((quads, np.roll(quads, -1, 1)), -1)].reshape(-1, 2)
    times = Counter(map(tuple, ends[ends[:, 0] != ends[:, 1]].tolist()))
    return all(count == times[b, a] for (a, b), count in times.items())


@pytest.mark.parametrize("name", SOLIDS)
def test_obstacles_are_surfaces(tmp_path, name):
    """Points at the distance 0 from the obstacle where it is at the instant; of what has an end,
    every edge is that of as many quadrilaterals in one direction as in the other.
    """
    touching = tb.Contact(SOLIDS[name], thickness=0.01, force=10.0)
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section()), [touching])
    state = replace(tb.rest(scene), t=torch.tensor(0.7))
    found = read(tb.export(state, tmp_path / "shape.vtu", scene=scene))
    assert same(found["points"][:3], state.position) and (found["kind"][:2] == 0).all()
    assert (found["kind"][2:] == 3).all() and (found["types"][2:] == 9).all()
    points = torch.tensor(found["points"][3:])
    (obstacle,) = standing(scene, 0.7)
    assert obstacle.distance(points).abs().max() < 1e-12
    quads = found["connectivity"][4:].reshape(-1, 4) - 3
    assert quads.min() == 0 and quads.max() == len(points) - 1
    if not isinstance(obstacle, tb.Plane | tb.Cylinder):
        assert closed(points, quads)
    assert np.isnan(found["velocity"][3:]).all() and np.isnan(found["force"][2:]).all()
    assert np.array_equal(found["offsets"][1:] - found["offsets"][:-1], [2] + [4] * len(quads))
    assert (found["part"][2:] == -1).all()


def test_tendons_and_surfaces_of_bodies(tmp_path):
    """A tendon of every sample from eyelet to eyelet; a ball about the body, where it is."""
    eyelets = [(("arm", 0), (0, 0, 0.05)), (("arm", 1), (0, 0, 0.05)), ("ball", (0, 0, 0))]
    rope = tb.Tendon(eyelets, tension=1.0)
    parts = {
        "arm": tb.Beam.straight(1.0, 2, section()),
        "ball": tb.Body(0.1, 1e-3, position=(1.0, 0, 0), surface=tb.Sphere((0, 0, 0), 0.1)),
    }
    scene = tb.Scene(
        parts,
        [rope, tb.PointLoad(("arm", -1), force=torch.tensor([[0.0, 0, 0.1], [0.0, 0.2, 0]]))],
        joints=tb.Weld(("arm", -1), "ball"),
        supports=tb.Support(("arm", 0)),
    )
    state = tb.equilibrium(scene)
    found = read(tb.export(state, tmp_path / "shape.vtu", scene=scene))
    eyelets = scene.tendons[0].at(state.position, state.rotation)
    nodes = 2 * state.position.shape[-2]
    assert same(found["points"][nodes : nodes + 6], eyelets)
    assert list(found["kind"][:10]) == [0, 0, 1] * 2 + [2] * 4
    assert list(found["sample"][6:10]) == [0, 0, 1, 1]
    ball = found["points"][nodes + 6 :] - state["ball"].position[0].numpy()
    assert np.abs(np.linalg.norm(ball, axis=-1) - 0.1).max() < 1e-12 and len(ball) > 100


def test_a_scene_goes_with_what_moves_in_it(tmp_path):
    with pytest.raises(ValueError, match="Scene with a scene was given"):
        tb.export(scene(), tmp_path / "shape.vtu", scene=scene())
    other = tb.Scene(tb.Beam.straight(1.0, 3, section()))
    with pytest.raises(ValueError, match="3 nodes was given; the beam has 4"):
        tb.export(tb.rest(scene()), tmp_path / "shape.vtu", scene=other)


def test_a_floor_has_one_size_in_all_instants(tmp_path):
    """And has one under a body alone."""
    floor = tb.Contact("ball", tb.Plane((0, 0, -0.2), (0, 0, 1.0)), radius=0.1, thickness=0.01,
                       force=100.0)  # fmt: skip
    alone = tb.Scene({"ball": tb.Body(0.1, 1e-3)}, [tb.Gravity((0, 0, -9.81)), floor])
    solution = tb.simulate(alone, torch.linspace(0, 0.1, 3), step=0.05)
    tb.export(solution, tmp_path / "run.pvd", scene=alone)
    first, *others = [read(tmp_path / "run" / f"{i}.vtu")["points"][1:5] for i in range(3)]
    assert all(np.array_equal(first, each) for each in others) and np.ptp(first[:, 0]) > 0.1
