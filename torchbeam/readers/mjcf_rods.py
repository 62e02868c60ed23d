"""Cables (MuJoCo 3: plugin `mujoco.elasticity.cable`) and rods (MuJoCo 4: flexes of dimension 1)
as beams, which neither stretch nor shear.

MuJoCo bends a chain of rigid edges at its vertices, each by the bending stiffness over the length
of its halves of the edges beside it. So an edge that is held begins to bend at its middle: a beam
that is clamped there agrees with second order of the edges' length, one that is clamped at the
first vertex with first order. A rod has its mass in its vertices, equal ones at the ends too: an
end that is free has half a vertex as a `PointMass`.

Source: MuJoCo documentation, "Modeling", "Rods", and "XML Reference", "flex/elasticity"; torsion of
a rectangle: Young and Budynas, Roark's Formulas, 7th ed., table 10.1.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..scene.beam import Beam
from ..scene.effects.damping import Damping
from ..scene.effects.point_mass import PointMass
from ..scene.section import Section
from .mjcf_model import Model

CABLE = "mujoco.elasticity.cable"
STRAIGHT = 1e-6  # of axes: how much they may differ along a straight cable
ALIKE = 1e-9  # of numbers of two sections


@dataclass
class Rod:
    """A beam, and what else there is of it.

    points       (n + 1, 3) m, its nodes
    bodies       of each MuJoCo body in it the nodes that it is between; points_only: those that are
                 a vertex, and do not turn
    held         (node, body, whether it is clamped)
    root         the first body of a cable, which has joints with its parent
    """

    name: str
    points: np.ndarray
    beam: Beam
    bodies: dict[int, tuple[int, ...]]
    effects: list[Any]
    held: list[tuple[int, int, bool]] = field(default_factory=list)
    root: int | None = None
    points_only: frozenset[int] = frozenset()


def rods(model: Model, spec: Any) -> Iterator[Rod]:
    cables = [body.id for body in spec.bodies if body.plugin.plugin_name == CABLE]
    chains: list[list[int]] = []
    for b in cables:
        chain = next((c for c in chains if c[-1] == model.m.body_parentid[b]), None)
        if chain is None:
            chains.append([b])
        else:
            chain.append(b)
    for chain in chains:
        yield from _cable(model, chain)
    for f, flex in enumerate(spec.flexes):
        yield from _flex(model, f, flex)


def _cable(model: Model, chain: list[int]) -> Iterator[Rod]:
    m, d, kinds = model.m, model.d, model.mujoco
    name = model.name("body", chain[0]).removesuffix("B_first").rstrip("_") or "cable"
    twist, bend, flat = _config(m, chain[0])
    wrong = None
    balls = [model.joints_of(b) for b in chain[1:]]
    if any(len(js) != 1 or int(m.jnt_type[js[0]]) != kinds.mjtJoint.mjJNT_BALL for js in balls):
        wrong = "joints other than one ball for each link"
    axes = d.xmat[chain].reshape(-1, 3, 3)
    if flat and np.abs(axes - axes[0]).max() > STRAIGHT:
        wrong = "flat = true, which is not straight"
    if not (twist > 0 and bend > 0):
        wrong = "no stiffness against twist or bend"
    geoms = [int(m.body_geomadr[b]) for b in chain]
    if min(geoms) < 0:
        wrong = "a link without geom"
    if wrong:
        model.changing.append(f"the cable {name!r} with {wrong}")
        return
    points = np.concatenate((d.xpos[chain], (2 * d.geom_xpos[geoms] - d.xpos[chain])[-1:]))
    length = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    numbers = []
    for b, g, size in zip(chain, geoms, length, strict=True):
        box = int(m.geom_type[g]) == kinds.mjtGeom.mjGEOM_BOX
        J, Iy, Iz = _rectangle(*m.geom_size[g][1:]) if box else _circle(m.geom_size[g][0])
        axes_b = np.zeros(9)
        kinds.mju_quat2Mat(axes_b, m.body_iquat[b])
        polar = m.body_inertia[b] @ axes_b.reshape(3, 3)[0] ** 2 / size
        numbers.append((twist * J, bend * Iy, bend * Iz, m.body_mass[b] / size, polar))
    if not len(model.joints_of(chain[0])):
        points[0] = (points[0] + points[1]) / 2
    beam = Beam.from_nodes(points, _sections(numbers), axes.copy())
    dofs = [int(m.jnt_dofadr[js[0]]) for js in balls]
    c = np.array([m.dof_damping[k] for k in dofs]) if dofs else np.zeros(1)
    effects = []
    if c.any():
        tau = c.max() * length.mean() / np.array(numbers[0][:3])
        effects.append(Damping((0.0, 0.0, 0.0, *tau.tolist()), on=name))
    if any(m.dof_armature[k] for k in dofs):
        model.changing.append(f"armature in the cable {name!r}")
    if np.ptp(c) > ALIKE * c.max() or any(m.jnt_stiffness[js[0]] for js in balls):
        model.changing.append(f"damping that varies, or joint springs, in the cable {name!r}")
    bodies = {b: (k, k + 1) for k, b in enumerate(chain)}
    yield Rod(name, points, beam, bodies, effects, root=chain[0])


def _config(m: Any, b: int) -> tuple[float, float, bool]:
    """twist and bend, N/m^2, and flat: the plugin keeps its attributes as words by this order."""
    first = int(m.plugin_attradr[m.body_plugin[b]])
    words = np.asarray(m.plugin_attr[first:]).astype(np.uint8).tobytes().split(b"\0")
    return float(words[0] or 0), float(words[1] or 0), words[2] == b"true"


def _flex(model: Model, f: int, flex: Any) -> Iterator[Rod]:
    m, d = model.m, model.d
    name, n = flex.name, int(m.flex_vertnum[f])
    first = int(m.flex_vertadr[f])
    holders = m.flex_vertbodyid[first : first + n].tolist()
    wrong = None
    if m.flex_dim[f] != 1 or not hasattr(flex, "shear"):
        wrong = "which is no rod of MuJoCo 4"
    elif list(flex.elem) != [k for j in range(n - 1) for k in (j, j + 1)]:
        wrong = "which is no open chain"
    elif flex.section.name.endswith("BOX"):
        wrong = "which has a box as its section"
    elif not flex.young > 0:
        wrong = "which does not resist bending"
    elif not (m.flex_edgeequality[f] == 1 or flex.edgestiffness > 0):
        wrong = "whose edges are free to stretch (no equality, no stiffness)"
    if wrong:
        model.changing.append(f"the flex {name!r}, {wrong}")
        return
    vertices = [
        k for k, b in enumerate(holders)
        if m.body_jntnum[b] == 3 and not m.flex_vert[first + k].any() and not m.body_geomnum[b]
    ]  # fmt: skip
    points = np.array([
        d.xpos[b] + d.xmat[b].reshape(3, 3) @ m.flex_vert[first + k] for k, b in enumerate(holders)
    ])  # fmt: skip
    length = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    J, I, _ = _circle(radius := float(m.flex_radius[f]))
    G = flex.shear or flex.young / (2 * (1 + flex.poisson))
    each = float(np.mean([m.body_mass[holders[k]] for k in vertices] or [0.0]))
    mass = each * (n - 1) / length.sum()
    EA = math.inf if m.flex_edgeequality[f] == 1 else flex.edgestiffness * length.mean()
    number = G * J, flex.young * I, flex.young * I, mass, mass * radius**2 / 2
    pinned = [k for k in range(n) if k not in vertices]
    held, clamps = [], {}
    for end, beside in ((0, 1), (n - 1, n - 2)):
        if end in pinned and beside in pinned and holders[end] == holders[beside]:
            clamps[end] = beside
    points_at = points.copy()
    for end, beside in clamps.items():
        points_at[end] = (points[end] + points[beside]) / 2
        held.append((end, holders[end], True))
    ends = {*clamps, *clamps.values()}
    held += [(k, holders[k], False) for k in pinned if k not in ends]
    beam = Beam.from_nodes(points_at, _sections([number], EA))
    effects: list[Any] = []
    if flex.damping:
        effects.append(Damping((0.0, 0.0, 0.0, *(3 * (float(flex.damping),))), on=name))
    effects += [PointMass(each / 2, node=(name, k)) for k in (0, n - 1) if k in vertices]
    if flex.edgedamping:
        model.changing.append(f"damping of the edges of the flex {name!r}")
    own = {holders[k]: (k,) for k in vertices}
    twisting = {
        int(m.jnt_bodyid[j]): (0,)
        for j in range(m.njnt)
        if m.joint(j).name == f"{name}_twist" or m.joint(j).name.startswith(f"{name}_twist_")
    }
    yield Rod(name, points_at, beam, own | twisting, effects, held, points_only=frozenset(own))


def _sections(numbers: list[tuple[float, ...]], EA: float = math.inf) -> Any:
    """One, or one for each element, of (GJ, EI about y, EI about z, mass, polar inertia)."""
    if np.ptp(numbers, axis=0).max() <= ALIKE * np.abs(numbers).max():
        numbers = numbers[:1]
    sections = []
    for GJ, EIy, EIz, mass, polar in numbers:
        inertia = polar * EIy / (EIy + EIz), polar * EIz / (EIy + EIz)
        EI = EIy if EIy == EIz else (EIy, EIz)
        sections.append(Section.from_stiffness(EA, math.inf, GJ, EI, mass, inertia))
    return sections[0] if len(sections) == 1 else sections


def _circle(r: float) -> tuple[float, float, float]:
    """J, and the second moments about y and z, m^4."""
    return math.pi * r**4 / 2, math.pi * r**4 / 4, math.pi * r**4 / 4


def _rectangle(y: float, z: float) -> tuple[float, float, float]:
    """The same of half sides y and z m."""
    a, b = max(y, z), min(y, z)
    J = a * b**3 * (16 / 3 - 3.36 * b / a * (1 - (b / a) ** 4 / 12))
    return J, 4 / 3 * y * z**3, 4 / 3 * z * y**3
