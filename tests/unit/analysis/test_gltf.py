"""export to glTF: what other libraries read is the geometry of the view, at each instant."""

import json

import numpy as np
import pytest
import torch

import torchbeam as tb
from torchbeam.math import quaternions as quat
from torchbeam.plot.moving_shapes import MovingShapes

trimesh = pytest.importorskip("trimesh")

UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # frame a's axes in glTF's, whose y is up


def structure():
    """An arm with a hub at its end, over a ball, and a rope to the ground."""
    arm = tb.Beam.straight(1.0, 3, tb.Section.rectangle(0.08, 0.01, E=1e7, nu=0.3, rho=1200.0))
    hub = tb.Body(0.2, 1e-4, (1.0, 0, 0), surface=tb.Sphere((0, 0, 0), 0.05))
    ball = tb.Contact("arm", tb.Sphere((0.5, 0, -0.3), 0.1), thickness=0.01, force=10.0)
    rope = tb.Tendon([(None, (0, 0, 0.5)), (("arm", -1), (0, 0, 0))], stiffness=5.0)
    return tb.Scene(
        {"arm": arm, "hub": hub},
        [tb.Gravity((0, 3.0, -9.81)), ball, rope],
        joints=tb.Weld(("arm", -1), "hub"),
        supports=tb.Support(("arm", 0)),
    )


@pytest.fixture(scope="module")
def motion():
    """The scene, and its motion at four instants."""
    scene = structure()
    return scene, tb.simulate(scene, torch.linspace(0.1, 0.4, 4), step=0.05)


def parts(path):
    """The JSON of a file, and a function from the number of an accessor to its numbers."""
    raw = path.read_bytes()
    version, size, length = np.frombuffer(raw[4:16], "<u4")
    assert raw[:4] == b"glTF" and version == 2 and size == len(raw)
    document, data = json.loads(raw[20 : 20 + length]), raw[28 + length :]

    def numbers(k):
        accessor = document["accessors"][k]
        view = document["bufferViews"][accessor["bufferView"]]
        kind = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        part = data[view["byteOffset"] :][: view["byteLength"]]
        values = np.frombuffer(part, kind).reshape(accessor["count"], -1)
        np.testing.assert_array_equal(values.min(0), accessor["min"])
        np.testing.assert_array_equal(values.max(0), accessor["max"])
        return values

    return document, numbers


def test_a_shape_as_another_library_reads_it(motion, tmp_path):
    """trimesh: the vertices and faces of every part of the view, turned so that z is up;
    undeformed, the arm's volume is that of its section times its length.
    """
    scene, state = motion[0], motion[1].state[-1]
    loaded = trimesh.load(tb.export(state, tmp_path / "shape.glb", scene=scene), process=False)
    shapes = MovingShapes(state, scene, 1).at(state, 0.0)
    assert set(loaded.geometry) == set(shapes)
    for name, (kind, static, moving) in shapes.items():
        matrix, mesh = loaded.graph.get(name)[0], loaded.geometry[name]
        if kind != "mesh_simple":
            continue
        points = moving.get("vertices", static.get("vertices"))
        if "wxyz" in moving:
            R = quat.matrix(torch.as_tensor(moving["wxyz"])).numpy()
            points = points @ R.T + moving["position"]
        there = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        np.testing.assert_allclose(there, points @ UP.T, atol=1e-6)
        np.testing.assert_array_equal(mesh.faces, static["faces"])
    drawn = trimesh.load(tb.export(scene, tmp_path / "drawn.glb"))
    assert abs(drawn.geometry["sample 0/beam 0"].volume / (0.08 * 0.01) - 1) < 1e-5


def test_a_motion_is_an_animation(motion, tmp_path):
    """At each instant the weighted morph targets are the vertices of the view, and the nodes of
    bodies are at their places; times count from 0, and a still obstacle has no channel.
    """
    scene, solution = motion
    document, numbers = parts(tb.export(solution, tmp_path / "run.glb", scene=scene))
    (animation,) = document["animations"]
    channels = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        np.testing.assert_allclose(numbers(sampler["input"])[:, 0], [0, 0.1, 0.2, 0.3], atol=1e-6)
        node = document["nodes"][channel["target"]["node"]]
        channels[node["name"], channel["target"]["path"]] = numbers(sampler["output"])
    moving = {name for name, _ in channels}
    assert not any("obstacle" in name for name in moving) and "tendon 0" in moving
    shapes = MovingShapes(solution.state[0], scene, 1)
    for k in range(4):
        for name, (_, _, now) in shapes.at(solution.state[k], 0.0).items():
            if (name, "weights") in channels:
                node = next(n for n in document["nodes"] if n["name"] == name)
                (primitive,) = document["meshes"][node["mesh"]]["primitives"]
                points = numbers(primitive["attributes"]["POSITION"]).copy()
                weights = channels[name, "weights"].reshape(4, -1)[k]
                for weight, target in zip(weights, primitive["targets"], strict=True):
                    points += weight * numbers(target["POSITION"])
                want = now.get("vertices", now.get("points"))
                np.testing.assert_allclose(points, want.reshape(-1, 3), atol=1e-6)
            elif "wxyz" in now:
                np.testing.assert_allclose(
                    channels[name, "translation"][k], now["position"], atol=1e-6
                )
                turn = channels[name, "rotation"][k][[3, 0, 1, 2]]
                assert abs(abs(turn @ now["wxyz"]) - 1) < 1e-6


def test_batches_and_refusals(tmp_path):
    """A failed or another sample has its colour; without a scene beams are thin; modes have no
    glTF, and a scene of another mesh is refused.
    """
    beam = tb.Beam.straight(1.0, 2, tb.Section.circle(0.01, E=1e7, nu=0.3, rho=1200.0))
    force = torch.tensor([[0.0, 0, 0.01], [0.0, 0.01, 0]])
    scene = tb.Scene(beam, [tb.TipLoad(force=force)])
    state = tb.equilibrium(scene)
    document, _ = parts(tb.export(state, tmp_path / "two.glb"))
    names = [node["name"] for node in document["nodes"][1:]]
    assert names == ["sample 0/beam 0", "sample 1/beam 0"] and len(document["materials"]) == 2
    assert "animations" not in document
    failing = tb.Scene(beam, [tb.TipLoad(force=torch.tensor([[0.0, 0, 0.01], [0.0, 0, 1e9]]))])
    with pytest.warns(RuntimeWarning, match="stopped"):
        motion = tb.simulate(failing, [0.0, 0.1], step=0.05)
    materials = parts(tb.export(motion, tmp_path / "two.glb"))[0]["materials"]
    red = [material["pbrMetallicRoughness"]["baseColorFactor"][0] for material in materials]
    assert 0.66 < red[1] < 0.68  # that of failed samples, from the first instant on
    modes = tb.modes(scene, state, count=1)
    with pytest.raises(ValueError, match=r"ends in \.vtu is wanted"):
        tb.export(modes, tmp_path / "modes.glb", state=state)
    with pytest.raises(ValueError, match="nodes"):
        tb.export(state, tmp_path / "two.glb", scene=structure())
