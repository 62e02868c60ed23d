"""`read`: a beam, a section, a damping or a scene from a file of another program."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from ..core.arguments import choice, number
from ..core.validation import refusal, shown
from .blade import Blade
from .text import Text

# module of a reader, which has SIGNS (a file of its kind contains one of them), parts(text) (what
# the file holds, the first by default) and read(text, part, length)
FORMATS = {
    "beamdyn": "beamdyn",
    "elastodyn": "elastodyn",
    "vabs": "vabs",
    "swiftcomp": "vabs",
    "windio": "windio",
    "mjcf": "mjcf",
    "urdf": "mjcf",
}

RECORDS = (".csv", ".tsv", ".txt")  # files of columns, of no program
PARTS = ("blade", "tower", "damping", "section", "scene", "arguments", "timestep")


def read(
    path: Any,
    *,
    format: str | None = None,
    part: str | None = None,
    elements: int | None = None,
    order: int = 1,
    length: float | None = None,
) -> Any:  # by the file, as the docstring says
    """Read a file of another program: a beam, a section, a damping, or a scene.

    | file | gives |
    |---|---|
    | BeamDyn, primary file | `Beam`; `part="damping"`: `Damping` |
    | BeamDyn, blade file with `length` | straight `Beam`; `part="damping"`: `Damping` |
    | ElastoDyn, primary file | `Beam` of the blade; `part="tower"`: of the tower |
    | ElastoDyn, blade or tower file with `length` | `Beam` |
    | windIO, versions 1 and 2 | `Beam` of the blade; `part="damping"`: `Damping` |
    | VABS (.K), SwiftComp (.k) | `Section` |
    | MJCF (MuJoCo), URDF | `Scene`; `part="arguments"`: a dict of the arguments of `Scene` |

    A beam stands in the file's axes at its root, which are frame a. There z is along it, x towards
    the suction side (of a tower downwind), y towards the trailing edge. The axes of a section are x
    along the beam, y the file's x, z the file's y, turned by the structural twist. A section of
    VABS or SwiftComp has the file's own axes.

    MJCF and URDF are read by MuJoCo itself, at `qpos0`. Frame a is the world. Rigidly connected
    bodies are one `Body`, cables and rods are beams, motors are inputs. A scene that would lack
    something that changes the motion is refused; its arguments come with a warning.

    Args:
        path: the file
        format: "beamdyn", "elastodyn", "windio", "vabs", "swiftcomp", "mjcf" or "urdf"; None = by
            its contents
        part: "blade", "tower", "damping" or "section"; of MJCF and URDF "scene", "arguments" or
            "timestep" (s); None = the first that the file has
        elements: of equal length along the reference axis; None = a node at each point of the axis,
            of an ElastoDyn file at each station
        order: of the elements, 1 or 2
        length: m, of a beam whose file does not say it

    6x6 matrices and twist are linear between stations, the reference axis is straight between
    points. BeamDyn lays a spline through the same points.

    Raises:
        ValueError: for another kind of file. For one that is cut off, has other counts than it
            says, or a matrix that is not symmetric or not positive. It names file and line.
            For a model that MuJoCo refuses, or that is no scene.
        ImportError: for windIO without PyYAML, which `torchbeam[readers]` brings. For MJCF and URDF
            without MuJoCo: `torchbeam[mujoco]`.

    Examples:
        >>> from pathlib import Path
        >>> rows = ["2 NBlInpSt", "1 AdjBlMs", "1 AdjFlSt", "1 AdjEdSt"]  # of ElastoDyn
        >>> rows += ["BlFract StrcTwst BMassDen FlpStff EdgStff", "(-) (deg) (kg/m) (Nm^2) (Nm^2)"]
        >>> rows += ["0.0 12.0 300.0 9e9 9e9", "1.0 0.0 20.0 2e7 9e7"]
        >>> size = Path("blade.dat").write_text("\\n".join(rows))
        >>> tb.read("blade.dat", length=60.0, elements=20).nodes[-1]  # m
        tensor([ 0.,  0., 60.])
    """
    text = Text(path)
    if format is not None:
        choice("format", format, FORMATS)
    reader = _reader(text, format)
    if part is not None:
        choice("part", part, PARTS)
    length = None if length is None else number("length", length)
    if length is not None and length <= 0:
        raise refusal(f"length = {length:g}", "a positive one")
    parts = reader.parts(text)
    chosen = parts[0] if part is None else part
    if chosen not in parts:
        wanted = " or ".join(f"part = {name!r}" for name in parts)
        raise refusal(f"part = {part!r} of {text.path.name}", wanted)
    content = reader.read(text, chosen, length)
    if isinstance(content, Blade):
        return content.beam(elements, order)
    if elements is not None or order != 1:
        raise refusal(f"elements or order for {chosen!r} of {text.path.name}", "neither")
    return content


def _reader(text: Text, format: str | None) -> Any:
    """The module that reads the file. Raises ValueError for a file of another kind."""
    load: Callable[[str], Any] = lambda name: importlib.import_module(  # noqa: E731
        f".{FORMATS[name]}", __package__
    )
    names = FORMATS if format is None else (format,)
    for reader in map(load, names):
        if any(text.find(sign) is not None for sign in reader.SIGNS):
            return reader
    wanted = "one of BeamDyn, ElastoDyn, windIO, VABS, SwiftComp, MJCF or URDF"
    wanted = wanted if format is None else f"one of format {shown(format)}"
    given = f"the file {text.path.name}"
    if text.path.suffix.lower() in RECORDS:
        given += ", whose columns numpy.loadtxt reads for a tb.Measurement,"
    raise refusal(given, wanted)
