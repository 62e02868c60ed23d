"""Export: motions, shapes and modes as files that ParaView opens, or as glTF.

VTK's XML formats: a `.vtu` file is an unstructured grid at one instant, a `.pvd` file names one for
each instant (Kitware, VTK file formats, https://docs.vtk.org/en/latest/vtk_file_formats).
"""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import torch
from torch import Tensor

from ..core.arguments import instance
from ..core.files import file_of, folder, written
from ..core.leaves import sent
from ..linear.modes import Modes
from ..math import quaternions as quat
from ..math.shapes import broadcast_shapes
from ..plot.obstacles import standing, surfaces
from ..plot.solids import surface_mesh
from ..scene.scene import Scene
from ..state.solution import Solution
from ..state.state import State, rest
from ..state.state_check import of_mesh
from .gltf import write_gltf

VERTEX, LINE, QUAD = 1, 3, 9  # VTK's numbers of cells
CELL_TYPES = {1: VERTEX, 2: LINE, 4: QUAD}  # by their points
BEAM, BODY, TENDON, SOLID = range(4)  # `kind` of a cell
TYPES = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}
INERT = 1e-300  # m: of a mode that moves nothing


class Beside(NamedTuple):
    """What stands beside the nodes of a scene: points (n, 3) m, cells (m, 2 or 4) of them."""

    kind: int
    sample: int
    points: np.ndarray
    cells: np.ndarray


def export(
    what: Any, path: str | Path, *, state: State | None = None, scene: Scene | None = None
) -> Path:
    """Write a motion, a shape or modes for ParaView, or a motion or a shape as glTF.

    Args:
        what: a `Solution`, a `State`, a `Scene` (undeformed), or `Modes`
        path: "run.pvd" for a solution: a folder "run" beside it gets a file for each instant.
            "shape.vtu" for anything else. "run.glb" is glTF 2.0, for Blender and web pages
        state: equilibrium of the modes
        scene: scene of a solution or a state: adds tendons of every sample, and obstacles and
            surfaces of bodies of the first sample

    Returns:
        The path.

    Each file has the nodes (m, frame a), a line between consecutive nodes, and a vertex for each
    body. `sample` counts a batch, `part` the parts of a structure. Data of points are `velocity`
    (m/s) and `angular velocity` (rad/s), both absolute, and the section axes `x`, `y`, `z`, all in
    frame a. Data of lines are `force` (N) and `moment` (N m) in section axes, nan for bodies.
    Elements of order 2 have the values of the Gauss point in each half. Modes have `mode k
    displacement` and `mode k turn`, frame a, at the instant of the largest component of the
    displacement. They are scaled so that this component is 1 (without displacement, the component
    of the turn). With a scene, `kind` tells the kind of each cell: 0 a beam, 1 a body, 2 a tendon,
    3 a surface. Tendons and surfaces have nan for all other data, and `part` -1.

    A glTF file shows what `tb.view` shows, of at most 16 samples of a batch: with a scene beams in
    their thickness, bodies, obstacles and tendons. A solution is an animation, exact at its
    instants and linear between them; its size grows with their number.

    Raises:
        ValueError: for another type or form, a path of another ending, or a missing folder. For
            modes without their state, or with a state of another batch. For a scene of another
            mesh, or a scene with modes or with a scene.
        NotWritten: (an OSError) where the disk is full.

    Examples:
        >>> solution = tb.simulate(scene, torch.linspace(0, 0.1, 6), step=0.01)
        >>> path = tb.export(solution, "run.pvd", scene=scene)  # open it in ParaView
        >>> film = tb.export(solution, "run.glb", scene=scene)
        >>> modes = tb.modes(scene, tb.equilibrium(scene))
        >>> path = tb.export(modes, "modes.vtu", state=tb.equilibrium(scene))
    """
    if isinstance(what, Modes) != (state is not None):
        raise ValueError(
            f"{type(what).__name__} {'with' if state is not None else 'without'} a state was given "
            "to export; modes and the state that they are about are wanted together"
        )
    if not isinstance(what, Solution | State | Scene | Modes):
        raise ValueError(
            f"{type(what).__name__} was given to export; a Solution, a State, a Scene or Modes are "
            "wanted"
        )
    if state is not None:
        instance("state", state, State)
    if scene is not None:
        instance("scene", scene, Scene)
        if not isinstance(what, Solution | State):
            raise ValueError(
                f"{type(what).__name__} with a scene was given to export; a Solution or a State is "
                "wanted with one"
            )
    endings = (".pvd" if isinstance(what, Solution) else ".vtu",)
    endings += () if isinstance(what, Modes) else (".glb",)
    path = file_of("path", path, *endings, of=f" for a {type(what).__name__}")
    if isinstance(what, Solution) and not isinstance(what.state, State):
        raise ValueError(
            f"a Solution of {type(what.state).__name__} was given to export; one of the nodal form "
            "is wanted"
        )
    folder(path.parent)
    if path.suffix == ".glb":
        return _gltf(what, path, scene)
    if isinstance(what, Solution):
        return _series(what, path, scene)
    if isinstance(what, Modes):
        _write(_grid(state, _mode_columns(what, state)), path)
    else:
        _write(_grid(rest(what) if isinstance(what, Scene) else what, scene=scene), path)
    return path


def _gltf(what: Any, path: Path, scene: Scene | None) -> Path:
    """A solution at its instants, or a shape at one."""
    if isinstance(what, Scene):
        what, scene = rest(what), what
    motion = isinstance(what, Solution)
    states = what.state if motion else what.map(lambda x: x[None])
    if scene is not None:
        of_mesh(states[0], scene, "a state")
    write_gltf(states, what.t.tolist() if motion else [0.0], scene, path)
    return path


def _series(solution: Solution, path: Path, scene: Scene | None) -> Path:
    """A file for each instant, and one that names them."""
    files = folder(path.with_suffix(""))
    root = ElementTree.Element("VTKFile", type="Collection", version="1.0")
    names = ElementTree.SubElement(root, "Collection")
    digits = len(str(len(solution.t) - 1))
    for i, t in enumerate(solution.t.tolist()):
        file = files / f"{i:0{digits}}.vtu"
        _write(_grid(solution.state[i], scene=scene), file)
        ElementTree.SubElement(names, "DataSet", timestep=repr(t), file=f"{files.name}/{file.name}")
    _write(root, path)
    return path


def _grid(
    state: State, extra: dict[str, Tensor] | None = None, scene: Scene | None = None
) -> ElementTree.Element:
    """A state, further vectors (..., N+1, 3) and what stands beside, as an unstructured grid."""
    R = quat.matrix(state.rotation)
    nodes = {
        "points": state.position,
        "velocity": state.velocity,
        "angular velocity": (R @ state.spin[..., None])[..., 0],
        **dict(zip("xyz", R.unbind(-1), strict=True)),
        **(extra or {}),
    }
    batch = broadcast_shapes(state.stress.shape[:-2], *(v.shape[:-2] for v in nodes.values()))
    flat = {name: _flat(v, batch) for name, v in nodes.items()}
    samples, count = flat["points"].shape[:2]
    cells = list(_cells(state, count))
    stress = _flat(state.stress, batch)
    load = np.stack(
        [np.full((samples, 6), np.nan) if row is None else stress[:, row] for *_, row in cells], 1
    )
    connectivity = np.concatenate([nodes for nodes, *_ in cells])
    ends = np.cumsum([len(nodes) for nodes, *_ in cells])
    first = np.arange(samples)[:, None]
    form = dict(byte_order="LittleEndian", header_type="UInt64")
    root = ElementTree.Element("VTKFile", type="UnstructuredGrid", version="1.0", **form)
    piece = ElementTree.SubElement(ElementTree.SubElement(root, "UnstructuredGrid"), "Piece")
    parts = np.array([part for _, part, _ in cells])
    groups: dict[str, dict[str, Any]] = {
        "Points": {"points": flat.pop("points")},
        "Cells": {
            "connectivity": first * count + connectivity,
            "offsets": first * len(connectivity) + ends,
            "types": np.tile(np.uint8([CELL_TYPES[len(nodes)] for nodes, *_ in cells]), samples),
        },
        "PointData": flat,
        "CellData": {
            "force": load[..., :3],
            "moment": load[..., 3:],
            "sample": np.broadcast_to(first, (samples, len(cells))),
            "part": np.broadcast_to(parts, (samples, len(cells))),
        },
    }
    if scene is not None:
        kinds = np.array([BODY if row is None else BEAM for *_, row in cells])
        groups["CellData"]["kind"] = np.broadcast_to(kinds, (samples, len(cells)))
        groups = _joined(groups, list(_beside(scene, state)))
    piece.set("NumberOfPoints", str(groups["Points"]["points"].size // 3))
    piece.set("NumberOfCells", str(groups["Cells"]["types"].size))
    for group, arrays in groups.items():
        element = ElementTree.SubElement(piece, group)
        for name, values in arrays.items():
            _array(element, name, values)
    return root


def _beside(scene: Scene, state: State) -> Iterator[Beside]:
    """Tendons, obstacles at the state's instant, and surfaces of bodies."""
    state = of_mesh(state, scene, "a state")
    for tendon in scene.tendons:
        eyelets = tendon.at(state.position.detach(), state.rotation.detach())
        steps = np.arange(eyelets.shape[-2] - 1)
        for sample, points in enumerate(_flat(eyelets, eyelets.shape[:-2])):
            yield Beside(TENDON, sample, points, np.stack((steps, steps + 1), -1))
    drawn = scene.beam.nodes.detach().double().reshape(-1, 3)
    size = (drawn.amax(0) - drawn.amin(0)).norm().item() or 1.0  # a body alone has no length
    eye = torch.eye(3, dtype=torch.float64)
    t = next(iter(state.t.flatten().tolist()), 0.0)  # of no sample any
    solids = [(torch.zeros(3, dtype=torch.float64), eye, each) for each in standing(scene, t)]
    for centre, R, obstacle in (*solids, *surfaces(scene, state)):
        mesh = surface_mesh(sent(obstacle, "cpu", torch.float64), size)
        mesh = mesh.moved(centre.double().cpu(), R.double().cpu())
        yield Beside(SOLID, 0, mesh.points.numpy(), mesh.quads.numpy())


def _joined(groups: dict[str, dict[str, Any]], beside: list[Beside]) -> dict[str, dict[str, Any]]:
    """The arrays of a grid with what stands beside the nodes behind them."""
    count = groups["Points"]["points"].reshape(-1, 3).shape[0]
    end = groups["Cells"]["connectivity"].size
    added: dict[str, list[np.ndarray]] = {"points": [], "connectivity": [], "offsets": []}
    for each in beside:
        added["points"].append(each.points)
        added["connectivity"].append((count + each.cells).ravel())
        added["offsets"].append(end + each.cells.shape[1] * (1 + np.arange(len(each.cells))))
        count, end = count + len(each.points), end + each.cells.size
    sizes = [len(each.cells) for each in beside]
    of_cells = {
        "types": [CELL_TYPES[each.cells.shape[1]] for each in beside],
        "sample": [each.sample for each in beside],
        "part": [-1] * len(beside),
        "kind": [each.kind for each in beside],
    }
    points = sum(len(each.points) for each in beside)
    joined: dict[str, dict[str, Any]] = {}
    for group, arrays in groups.items():
        joined[group] = {}
        for name, values in arrays.items():
            if name in added:
                more = np.concatenate([np.empty((0, *values.shape[2:])), *added[name]])
            elif name in of_cells:
                more = np.repeat(of_cells[name], sizes)
            else:
                more = np.full((points if group == "PointData" else sum(sizes), 3), np.nan)
            flat = values.reshape(-1, *more.shape[1:])
            joined[group][name] = np.concatenate((flat, more)).astype(values.dtype)
    return joined


def _cells(state: State, count: int) -> Iterator[tuple[list[int], int, int | None]]:
    """Nodes, part and station of each: lines of beams, vertices of bodies."""
    if not state.parts:
        yield from (([i, i + 1], 0, i) for i in range(count - 1))
    for k, part in enumerate(state.parts):
        if part.body:
            yield [part.first_node], k, None
        for i in range(part.station_count):
            yield [part.first_node + i, part.first_node + i + 1], k, part.first_station + i


def _mode_columns(modes: Modes, state: State) -> dict[str, Tensor]:
    """Vectors of nodes (..., N+1, 3) by name: displacement and turn of each mode."""
    batch, nodes = modes.shape.shape[:-3], modes.shape.shape[-2]
    if state.position.shape[:-2] != batch or state.position.shape[-2] != nodes:
        raise ValueError(
            f"modes of {nodes} nodes in the batch {tuple(batch)} and a state of "
            f"{state.position.shape[-2]} in {tuple(state.position.shape[:-2])} were given; the "
            "state that the modes are about is wanted"
        )
    columns = {}
    for k, shape in enumerate(modes.shape.detach().unbind(-3), 1):
        parts = shape.split(3, -1)
        sizes = [part.flatten(-2).abs().amax(-1) for part in parts]
        moves = sizes[0] > torch.finfo(sizes[0].dtype).eps * sizes[1]
        leading = torch.where(moves[..., None, None], *parts).flatten(-2)
        peak = leading.gather(-1, leading.abs().argmax(-1, keepdim=True))[..., None]
        peak = torch.where(peak.abs() > INERT, peak, 1)
        for name, part in zip(("displacement", "turn"), parts, strict=True):
            columns[f"mode {k} {name}"] = (part / peak).real
    return columns


def _flat(x: Tensor, batch: torch.Size) -> np.ndarray:
    """(samples, rows, columns)."""
    x = x.detach().expand(*batch, *x.shape[-2:])
    return x.reshape(batch.numel(), *x.shape[-2:]).double().cpu().numpy()


def _array(parent: ElementTree.Element, name: str, values: np.ndarray) -> None:
    """Numbers in base64, behind how many bytes they are."""
    values = np.ascontiguousarray(values)
    width = values.shape[-1] if values.dtype == np.float64 else 1
    about = dict(type=TYPES[str(values.dtype)], Name=name, NumberOfComponents=str(width))
    element = ElementTree.SubElement(parent, "DataArray", **about, format="binary")
    data = values.astype(values.dtype.newbyteorder("<")).tobytes()
    element.text = base64.b64encode(np.array(len(data), "<u8").tobytes() + data).decode()


def _write(root: ElementTree.Element, path: Path) -> None:
    ElementTree.indent(root)
    with written(path) as part:
        ElementTree.ElementTree(root).write(part, "utf-8", xml_declaration=True)
