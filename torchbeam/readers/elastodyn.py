"""ElastoDyn: blade file, tower file, and the primary file that names both.

A blade has no stiffness but flap and edge: it neither stretches, shears nor twists (`math.inf`).
Values are looked up by name, columns by their heading (`PitchAxis` left in version 2).

Source: ElastoDyn input files (OpenFAST), "Blade" and "Tower"; Jonkman et al. 2009,
NREL/TP-500-38060, for the flap and edge axes.
"""

from __future__ import annotations

import math

import torch

from ..core.validation import refusal
from ..scene.section import Section
from .blade import Blade
from .text import Text

SIGNS = ("NBlInpSt", "NTwInpSt", "TipRad")
# of a file's table: (the number of its rows, its first column, then mass, the stiffness against
# moving along the file's x, and along its y; factors of these)
TABLES = {
    "blade": ("NBlInpSt", ("BlFract", "BMassDen", "FlpStff", "EdgStff"),
              ("AdjBlMs", "AdjFlSt", "AdjEdSt")),
    "tower": ("NTwInpSt", ("HtFract", "TMassDen", "TwFAStif", "TwSSStif"),
              ("AdjTwMa", "AdjFASt", "AdjSSSt")),
}  # fmt: skip


def parts(text: Text) -> tuple[str, ...]:
    """What such a file holds: a primary file names those of both."""
    there = (name for name, table in TABLES.items() if text.find(table[0]) is not None)
    return tuple(there) or tuple(TABLES)


def read(text: Text, part: str, length: float | None) -> Blade:
    """The blade or the tower of a file with its `length` m, or of a primary file, which says it."""
    if text.find("TipRad") is not None:
        if length is not None:
            raise refusal(f"length = {length:g} with {text.path.name}, which says it,", "no length")
        if part == "blade":
            name = text.value("BldFile(1)", "BldFile1")[0]
            length = text.number("TipRad") - text.number("HubRad")
        else:
            name = text.value("TwrFile")[0]
            length = text.number("TowerHt") - text.number("TowerBsHt")
        text = Text(text.beside(name))
    if length is None:
        wanted = "length=, from the hub's radius to the tip, or the primary file"
        wanted = wanted if part == "blade" else "length=, or the primary file"
        raise refusal(f"{text.path.name}, which does not say how long it is,", wanted)
    return _of_table(text, part, float(length))


def _of_table(text: Text, part: str, length: float) -> Blade:
    rows, names, factors = TABLES[part]
    total = text.count(rows, least=2)
    k = text.find(*names)
    if k is None:
        raise refusal(f"{text.path.name} without a table of {', '.join(names)}", "a whole file")
    headings = text.lines[k].split()
    text.line = k + 2  # units come below
    table = [text.row(len(headings), names[0]) for _ in range(total)]
    columns = dict(zip(headings, torch.tensor(table, dtype=torch.float64).unbind(-1), strict=True))
    eta, *numbers = (columns[name] for name in names)
    mass, along_x, along_y = (
        x * text.number(factor) for x, factor in zip(numbers, factors, strict=True)
    )
    try:
        sections = [
            Section.from_stiffness(
                math.inf, math.inf, math.inf, EI=(along_y[i], along_x[i]), mass=mass[i]
            )
            for i in range(total)
        ]
    except ValueError as error:
        raise ValueError(f"{text.path.name}, table from line {k + 3} on: {error}") from None
    twist = columns.get("StrcTwst", torch.zeros_like(eta)) * (math.pi / 180)
    points = torch.stack((0 * eta, 0 * eta, eta * length), -1)
    return Blade(points, twist, eta, sections, text.path.name)
