"""glTF 2.0 in one binary file (.glb): a motion, a shape or a scene as any viewer shows it.

The geometry is that of `tb.view`. What bends is a mesh with a morph target for each instant, so
that its vertices are exact there and go straight in between; a body is a mesh that a node moves.

Source: Khronos Group, glTF 2.0 specification (2021), ISO/IEC 12113:2022.
"""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..core.files import written
from ..plot.moving_shapes import MovingShapes
from ..scene.scene import Scene

SAMPLES = 16  # of a batch, as in a view
FLOAT, UINT = 5126, 5125  # glTF's component types
VERTICES, INDICES = 34962, 34963  # and targets of buffer views
TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
LINES, TRIANGLES = 1, 4
UPRIGHT = [-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]  # glTF's y is frame a's z


class Document:
    """The parts of a file under way: JSON, and the bytes that it points to."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "torchbeam"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"name": "frame a", "rotation": UPRIGHT, "children": []}],
            "meshes": [],
            "materials": [],
            "accessors": [],
            "bufferViews": [],
        }
        self.channels: list[dict[str, Any]] = []
        self.samplers: list[dict[str, Any]] = []

    def added(self, group: str, item: dict[str, Any]) -> int:
        self.json[group].append(item)
        return len(self.json[group]) - 1

    def array(self, values: np.ndarray, target: int | None = None) -> int:
        """The accessor of numbers (n,) or (n, columns)."""
        integers = values.dtype.kind in "iu"
        values = np.ascontiguousarray(values, "<u4" if integers else "<f4")
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": values.nbytes}
        self.data += values.tobytes()
        flat = values.reshape(len(values), -1)
        return self.added("accessors", {
            "bufferView": self.added("bufferViews", view | ({"target": target} if target else {})),
            "componentType": UINT if integers else FLOAT,
            "count": len(values),
            "type": TYPES[flat.shape[1]],
            "min": flat.min(0).tolist(),
            "max": flat.max(0).tolist(),
        })  # fmt: skip

    def animate(self, node: int, path: str, times: int, values: np.ndarray) -> None:
        self.samplers.append({"input": times, "output": self.array(values)})
        target = {"node": node, "path": path}
        self.channels.append({"sampler": len(self.samplers) - 1, "target": target})

    def mesh(self, name: str, static: dict[str, Any], frames: list[dict[str, Any]]) -> int:
        """The node of a mesh or of lines, whose vertices at all instants are in `frames`."""
        lines = "faces" not in static
        points = [_vertices(static, moving) for moving in frames]
        primitive: dict[str, Any] = {
            "attributes": {"POSITION": self.array(points[0], VERTICES)},
            "material": self._material(static),
            "mode": LINES if lines else TRIANGLES,
        }
        if not lines:
            primitive["indices"] = self.array(static["faces"].ravel(), INDICES)
        mesh: dict[str, Any] = {"name": name, "primitives": [primitive]}
        if any((x != points[0]).any() for x in points):
            moves = [self.array(x - points[0], VERTICES) for x in points[1:]]
            primitive["targets"] = [{"POSITION": move} for move in moves]
            mesh["weights"] = [0.0] * len(moves)
        node = self.added("nodes", {"name": name, "mesh": self.added("meshes", mesh)})
        self.json["nodes"][0]["children"].append(node)
        return node

    def _material(self, static: dict[str, Any]) -> int:
        """Its colour; glTF's is linear (sRGB, IEC 61966-2-1)."""
        rgb = np.array(static["color"] if "color" in static else static["colors"]) / 255
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        opacity = static.get("opacity", 1.0)
        colour = {"baseColorFactor": [*linear.tolist(), opacity], "metallicFactor": 0.0}
        material = {"pbrMetallicRoughness": colour, "doubleSided": True}
        material |= {"alphaMode": "BLEND"} if opacity < 1 else {}
        if material in self.json["materials"]:
            return self.json["materials"].index(material)
        return self.added("materials", material)

    def write(self, path: Path) -> None:
        if self.channels:
            motion = {"name": "motion", "channels": self.channels, "samplers": self.samplers}
            self.json["animations"] = [motion]
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps(self.json, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        with written(path) as part:
            head = b"glTF" + np.array([2, 28 + len(text) + len(self.data)], "<u4").tobytes()
            chunk = np.array([len(text)], "<u4").tobytes() + b"JSON" + text
            data = np.array([len(self.data)], "<u4").tobytes() + b"BIN\0" + bytes(self.data)
            part.write_bytes(head + chunk + data)


def write_gltf(states: Any, t: list[float], scene: Scene | None, path: Path) -> None:
    """States (time, ...) at t (s), of a form that a view shows."""
    shapes = MovingShapes(states[0], scene, SAMPLES)
    instants = [shapes.at(states[k], time) for k, time in enumerate(t)]
    document = Document()
    times = document.array(np.array(t) - t[0]) if len(t) > 1 else None
    for name, (_, static, moving) in instants[-1].items():  # a sample that fails is red
        frames = [instant[name][2] for instant in instants]
        node = document.mesh(name, static, frames)
        if "position" in moving:
            places = np.array([frame["position"] for frame in frames])
            turns = _continuous(np.array([frame["wxyz"] for frame in frames]))[:, [1, 2, 3, 0]]
            at = document.json["nodes"][node]
            at |= {"translation": places[0].tolist(), "rotation": turns[0].tolist()}
            if times is not None:
                document.animate(node, "translation", times, places)
                document.animate(node, "rotation", times, turns)
        elif "weights" in document.json["meshes"][-1]:
            document.animate(node, "weights", times, np.eye(len(t))[:, 1:].ravel())
    document.write(path)


def _vertices(static: dict[str, Any], moving: dict[str, Any]) -> np.ndarray:
    """(n, 3) m"""
    if "points" in moving:
        return moving["points"].reshape(-1, 3)
    return moving.get("vertices", static.get("vertices"))


def _continuous(q: np.ndarray) -> np.ndarray:
    """Quaternions (time, 4) of the same rotations, each with the sign that is next to the last."""
    signs = np.cumprod([1.0, *(math.copysign(1.0, a @ b) for a, b in pairwise(q))])
    return q * signs[:, None]
