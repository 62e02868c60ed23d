"""MJCF and URDF, by MuJoCo's own reader (extra `mujoco`), which takes both: includes, defaults,
frames, units and the inertia of geoms are its business. The model that it compiles becomes a scene
of bodies, beams, joints and tendons, in the pose of `qpos0`.

One path serves both formats. Parsers of URDF alone (yourdfpy, urchin) bring trimesh, lxml and
networkx, and would be a second path to the same joints.

Source: MuJoCo documentation, "Computation" and "XML Reference".
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..core.validation import refusal
from ..core.warning import warn
from ..math import quaternions as quat
from ..scene.ball import Ball
from ..scene.body import Body
from ..scene.effects.gravity import Gravity
from ..scene.effects.obstacles import Box, Capsule, Sphere
from ..scene.joints import Weld
from ..scene.scene import Scene
from ..scene.supports import Support
from .mjcf_joints import joint
from .mjcf_model import Model
from .mjcf_rods import CABLE, rods
from .mjcf_ties import equalities, motors, tendons
from .text import Text

SIGNS = ("<mujoco", "<robot")
LIGHT = 1e-6  # of a body's mass: that of a body between two of its joints
ROUNDING = 0.1  # of the smallest side of a box: radius of its edges
SWITCHES = (
    "CONSTRAINT",
    "EQUALITY",
    "FRICTIONLOSS",
    "LIMIT",
    "PASSIVE",
    "SPRING",
    "DAMPER",
    "ACTUATION",
)


def parts(text: Text) -> tuple[str, ...]:
    """What such a file holds."""
    return "scene", "arguments", "timestep"


def read(text: Text, part: str, length: float | None) -> Any:
    """The scene; its arguments by name; or the time step in s."""
    text.refuse_length(length, "a model")
    try:
        import mujoco
    except ImportError:
        raise ImportError(
            "torchbeam.read of MJCF or URDF wants mujoco: pip install 'torchbeam[mujoco]'"
        ) from None
    try:
        spec = mujoco.MjSpec.from_file(str(text.path))
        _without_meshes(spec, mujoco.mjtGeom.mjGEOM_MESH)
        compiled = spec.compile()
    except ValueError as error:
        old = "; a version before 4 reads cables" if "composite" in str(error) else ""
        raise ValueError(
            f"{text.path.name} was given, which MuJoCo {mujoco.__version__} refuses{old}: "
            f"{' '.join(str(error).split())}"
        ) from None
    if part == "timestep":
        return float(compiled.opt.timestep)
    return Reader(mujoco, spec, compiled, text.path.name).arguments(part)


def _without_meshes(spec: Any, kind: Any) -> None:
    """Of bodies whose inertia is given, meshes are not needed: their files may be missing."""
    for geom in list(spec.geoms):
        if geom.type == kind and geom.parent.explicitinertial:
            spec.delete(geom)
    used = {geom.meshname for geom in spec.geoms}
    for mesh in list(spec.meshes):
        if mesh.name not in used:
            spec.delete(mesh)


class Reader(Model):
    """A model on its way to a scene."""

    def __init__(self, mujoco: Any, spec: Any, compiled: Any, file: str) -> None:
        super().__init__(mujoco, compiled, file)
        self.rods = {rod.name: rod for rod in rods(self, spec)}
        self.motors = motors(self)
        plugins = {body.plugin.plugin_name for body in spec.bodies} - {"", CABLE}
        self.changing += [f"the plugin {name}" for name in sorted(plugins)]

    def arguments(self, part: str) -> Any:
        """Raises ValueError for a scene without something that changes its motion."""
        self._homes()
        for rod in self.rods.values():
            self.parts[rod.name] = rod.beam
            self.effects += rod.effects
        self._bodies()
        for b in range(1, self.m.nbody):
            self._joints(b)
        self._held()
        self.joints += equalities(self)
        self.effects += tendons(self)
        self._options()
        if not self.parts:
            raise refusal(f"{self.file} without anything that moves", "a body, a cable or a rod")
        if self.changing and part == "scene":
            raise refusal(
                f"{self.file} with {'; '.join(self.changing)}, which a scene cannot have,",
                "a model without, or part = 'arguments', which reads the rest,",
            )
        if left := self.changing + self.beside:
            warn(f"{self.file} was read without {'; '.join(left)}", UserWarning)
        arguments = dict(
            beam=self.parts, effects=self.effects, joints=self.joints, supports=self.supports
        )
        return arguments if part == "arguments" else Scene(**arguments)

    def _homes(self) -> None:
        for rod in self.rods.values():
            self.home |= {b: (rod.name, nodes) for b, nodes in rod.bodies.items()}
        for b in range(1, self.m.nbody):
            if b not in self.home:
                parent = self.home[int(self.m.body_parentid[b])]
                moves = self.m.body_jntnum[b] or (isinstance(parent, tuple) and self.m.body_mass[b])
                self.home[b] = self.own(b) if moves else parent

    def _bodies(self) -> None:
        """Bodies that are rigidly connected are one, in the axes of the first."""
        m, d = self.m, self.d
        for name in dict.fromkeys(home for home in self.home.values() if isinstance(home, str)):
            group = [b for b, home in self.home.items() if home == name]
            mass, R = m.body_mass[group].sum(), d.xmat[group[0]].reshape(3, 3).copy()
            centre = m.body_mass[group] @ d.xipos[group] / mass
            inertia = np.zeros((3, 3))
            for b in group:
                axes, arm = d.ximat[b].reshape(3, 3), d.xipos[b] - centre
                inertia = inertia + axes @ np.diag(m.body_inertia[b]) @ axes.T
                inertia += m.body_mass[b] * (arm @ arm * np.eye(3) - np.outer(arm, arm))
            inertia = R.T @ inertia @ R
            surface = self._surface(group, centre, R)
            self.parts[name] = Body(mass, (inertia + inertia.T) / 2, centre, R, surface)

    def _surface(self, group: list[int], centre: np.ndarray, R: np.ndarray) -> Any:
        """Of bodies with one geom, if it is a ball, a capsule or a box."""
        m, d, kinds = self.m, self.d, self.mujoco.mjtGeom
        geoms = [g for g in range(m.ngeom) if int(m.geom_bodyid[g]) in group]
        if len(geoms) != 1:
            return None
        (g,) = geoms
        at, axes = R.T @ (d.geom_xpos[g] - centre), R.T @ d.geom_xmat[g].reshape(3, 3)
        size, half, kind = m.geom_size[g], m.geom_size[g][1] * axes[:, 2], int(m.geom_type[g])
        if kind == kinds.mjGEOM_SPHERE:
            return Sphere(at, size[0])
        if kind == kinds.mjGEOM_CAPSULE:
            return Capsule(at - half, at + half, size[0])
        if kind != kinds.mjGEOM_BOX:
            return None
        turn = quat.logarithm(quat.from_matrix(torch.as_tensor(axes))).numpy()
        return Box(at, 2 * size, 2 * ROUNDING * size.min(), turn)

    def _joints(self, b: int) -> None:
        """Of a body, or of the first of a cable, with its parent: one after the other, with light
        bodies between them.
        """
        home, at = self.home[b], self.d.xpos[b]
        child = home
        if isinstance(home, tuple):
            child = (home[0], 0)
            if self.rods[home[0]].root != b:
                return
        elif home != self.own(b):
            return
        parent, numbers = self.end(int(self.m.body_parentid[b]), at), self.joints_of(b)
        if not numbers:
            self._fix(parent, child)
        for j in numbers:
            end = child
            if j != numbers[-1]:
                end = f"{self.name('body', b)} behind {self.name('joint', j)}"
                light = LIGHT * self.m.body_mass[b], LIGHT * self.m.body_inertia[b].sum() / 2
                self.parts[end] = Body(*light, position=self.d.xanchor[j].copy())
            self.joints += joint(self, j, parent, end)
            parent = end

    def _held(self) -> None:
        """Nodes of rods that are pinned to bodies."""
        for rod in self.rods.values():
            for node, b, clamped in rod.held:
                at, child = rod.points[node], (rod.name, node)
                holder = self.end(b, at)
                if clamped:
                    self._fix(holder, child)
                elif holder is None:
                    self.supports.append(Support(child, rotation=""))
                else:
                    self.joints.append(Ball(holder, child, at=at))

    def _fix(self, parent: Any, child: Any) -> None:
        if parent is None:
            self.supports.append(Support(child))
        else:
            self.joints.append(Weld(parent, child))

    def _options(self) -> None:
        """Gravity, and what the whole model has."""
        option, bits = self.m.opt, self.mujoco.mjtDisableBit
        off = {
            name.removeprefix("mjDSBL_"): bool(option.disableflags & getattr(bits, name).value)
            for name in dir(bits)
            if name.startswith("mjDSBL_")
        }
        if option.gravity.any() and not off["GRAVITY"]:
            self.effects.append(Gravity(option.gravity.copy()))
        if option.density or option.viscosity:
            self.changing.append("a fluid (density or viscosity)")
        if self.m.body_gravcomp.any():
            self.changing.append("gravity compensation")
        if switched := [name.lower() for name in SWITCHES if off.get(name)]:
            self.changing.append(f"{', '.join(switched)} switched off")
        touching = self.m.geom_contype.any() or self.m.flex_contype.any() or self.m.npair
        if touching and not off["CONTACT"]:
            self.beside.append("contact of geoms (add `Contact`)")
        if self.m.nkey:
            self.beside.append("keyframes (the pose is that of qpos0)")
        if self.m.nmocap:
            self.beside.append("the motion of mocap bodies (they are the ground)")
