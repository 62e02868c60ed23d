"""A model that MuJoCo has compiled, and what becomes of its bodies."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..math import quaternions as quat


class Model:
    """A compiled model m, its pose d at qpos0, and the arguments of a scene.

    home      of each MuJoCo body: None = the ground, the name of a body that it is rigidly part of,
              or the name of a rod with the nodes that it is between
    motors    name of the input that drives a joint, ("joint", number), or a tendon
    servos    (3,) of a joint: effort, and its slopes by coordinate and rate, of a motor without
              input
    changing  in words, what is left out, and the motion is another without; beside: likewise, of
              what may not matter
    """

    def __init__(self, mujoco: Any, compiled: Any, file: str) -> None:
        self.mujoco, self.m, self.file = mujoco, compiled, file
        self.d = mujoco.MjData(compiled)
        mujoco.mj_kinematics(self.m, self.d)
        self.changing: list[str] = []
        self.beside: list[str] = []
        self.parts: dict[str, Any] = {}
        self.joints: list[Any] = []
        self.effects: list[Any] = []
        self.supports: list[Any] = []
        self.rods: dict[str, Any] = {}
        self.home: dict[int, Any] = {0: None}
        self.motors: dict[tuple[str, int], str] = {}
        self.servos: dict[int, np.ndarray] = {}

    def name(self, kind: str, i: int) -> str:
        """Of an object; of one without a name its kind and number."""
        return getattr(self.m, kind)(i).name or f"{kind} {i}"

    def refuse(self, of: str, i: Any, *arrays: str) -> None:
        """What these arrays have at i, of an object; other versions of MuJoCo have other ones."""
        some = [x for x in arrays if hasattr(self.m, x) and np.any(getattr(self.m, x)[i])]
        self.changing += [f"{array.split('_')[1]} of {of}" for array in some]

    def own(self, b: int) -> str:
        """The name of a body, which no rod has."""
        name = self.name("body", b)
        return f"body {name}" if name in self.rods else name

    def joints_of(self, b: int) -> range:
        first = int(self.m.body_jntadr[b])
        return range(first, first + int(self.m.body_jntnum[b]))

    def end(self, b: int, at: np.ndarray) -> Any:
        """The node, or the part, of a MuJoCo body that is nearest to a place (3) m."""
        home = self.home[b]
        if not isinstance(home, tuple):
            return home
        name, nodes = home
        apart = np.linalg.norm(self.rods[name].points[list(nodes)] - at, axis=-1)
        return name, nodes[int(apart.argmin())]

    def eyelet(self, b: int, at: np.ndarray) -> tuple[Any, np.ndarray]:
        """The same, and the place in the axes of that node."""
        node = self.end(b, at)
        if node is None:
            return None, at.copy()
        part = self.parts[node if isinstance(node, str) else node[0]]
        if isinstance(node, str):
            return node, np.asarray(part.rotation).T @ (at - np.asarray(part.position))
        R = quat.matrix(part.frames[node[1]]).numpy()
        return node, R.T @ (at - part.nodes[node[1]].numpy())
