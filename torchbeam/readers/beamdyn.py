"""BeamDyn: the primary input file with key points, and the blade file with 6x6 matrices.

Values are looked up by their names, and tables by their headings, so that files of all versions
are read (modal damping, `RotStates`, load retries came in later ones). `openfast_io` reads by line
number the files of its own release alone, and says nothing of a wrong line.

Source: BeamDyn User's Guide (OpenFAST), "Input Files": the reference axis and the twist about the
negative z axis; the order of the 6x6 matrices and of mu.
"""

from __future__ import annotations

import math

import torch

from ..core.validation import refusal
from ..scene.effects.damping import Damping
from ..scene.section import Section
from .blade import ORDER, Blade, reordered, section_of
from .text import Text

SIGNS = ("kp_total", "station_total")  # what such a file contains, one of these


def parts(text: Text) -> tuple[str, ...]:
    """What such a file holds."""
    return "blade", "damping"


def read(text: Text, part: str, length: float | None) -> Blade | Damping:
    """`part` of the blade of a primary file, or of a blade file with a `length` m: it is straight
    then, and has no twist.
    """
    if text.find("kp_total") is None:
        return damping(text) if part == "damping" else _straight(text, length)
    if length is not None:
        raise refusal(f"length = {length:g} with {text.path.name}, which says it,", "no length")
    properties = Text(text.beside(text.value("BldFile")[0]))
    if part == "damping":
        return damping(properties)
    points, twist = _key_points(text)
    eta, sections = stations(properties)
    return Blade(points, twist, eta, sections, properties.path.name)


def _key_points(text: Text) -> tuple[torch.Tensor, torch.Tensor]:
    total, members = text.count("kp_total", least=2), text.count("member_total")
    text.line = text.value("kp_total")[1] + 1
    each = [int(text.row(2, "a member and its key points")[1]) for _ in range(members)]
    if sum(each) - (members - 1) != total:
        raise text.refusal(
            text.line - 1,
            f"kp_total = {total} with members of {', '.join(map(str, each))} key points",
            "a sum of these, ends shared",
        )
    text.after("kp_xr", skip=2)
    rows = torch.tensor([text.row(4, "a key point") for _ in range(total)], dtype=torch.float64)
    return rows[:, :3], rows[:, 3] * (math.pi / 180)


def stations(text: Text) -> tuple[torch.Tensor, list[Section]]:
    """Shares of the blade's length (n,), and the section at each."""
    total = text.count("station_total", least=2)
    text.after("Distributed Properties")
    eta, sections = [], []
    for _ in range(total):
        eta += text.row(1, "a station's eta")
        at = text.line
        stiffness = reordered(text.matrix(6, "a stiffness"))
        mass = reordered(text.matrix(6, "a mass"))
        try:
            sections.append(section_of(stiffness, mass))
        except ValueError as error:
            raise ValueError(f"{text.path.name}, station of line {at}: {error}") from None
    return torch.tensor(eta, dtype=torch.float64), sections


def damping(text: Text) -> Damping:
    """Stiffness-proportional: mu is the time tau of each strain rate, in s."""
    k = text.find("mu1", "mu6")
    if k is None:
        raise refusal(f"{text.path.name} without mu1 to mu6", "a BeamDyn blade file")
    kind = text.number("damp_type")
    if kind != 1:
        at = text.value("damp_type")[1]
        raise text.refusal(at, f"damp_type = {kind:g}", "1, proportional to stiffness,")
    text.line = k + 2
    mu = text.row(6, "mu")
    return Damping(tuple(mu[i] for i in ORDER))


def _straight(text: Text, length: float | None) -> Blade:
    if length is None:
        raise refusal(
            f"{text.path.name}, a BeamDyn blade file without its key points,",
            "the primary file, or length=",
        )
    eta, sections = stations(text)
    points = torch.tensor(((0.0, 0, 0), (0, 0, 1)), dtype=torch.float64) * length
    points = points[0] + eta[:, None] * (points[1] - points[0])
    return Blade(points, torch.zeros_like(eta), eta, sections, text.path.name)
