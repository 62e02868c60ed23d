"""windIO: the blade of a turbine's YAML file, versions 1 and 2, whose 6x6 matrices are given.

PyYAML reads the file. The library `windIO` would validate it, and convert version 1 to 2, but needs
xarray, netCDF4 and jsonschema, and its conversion wants the whole turbine.

Source: windIO's turbine schema (IEA Wind Task 55), `reference_axis`, `outer_shape.twist` in degrees
and `structure.elastic_properties`; version 1: `elastic_properties_mb.six_x_six`, twist in rad. Axes
are those of BeamDyn.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from ..core.validation import refusal, shown
from ..scene.effects.damping import Damping
from ..scene.stations import Table
from .blade import ORDER, Blade, reordered, section_of
from .text import Text, check_matrix

SIGNS = ("components:",)
UPPER = tuple((i, j) for i in range(6) for j in range(i, 6))  # as 21 numbers are listed
INERTIA = ("mass", "cm_x", "cm_y", "i_edge", "i_flap", "i_plr", "i_cp")


def parts(text: Text) -> tuple[str, ...]:
    """What such a file holds."""
    return "blade", "damping"


def read(text: Text, part: str, length: float | None) -> Blade | Damping:
    """`part` of the blade."""
    if length is not None:
        raise refusal(f"length = {length:g} with {text.path.name}, which says it,", "no length")
    entry = _Entry(_loaded(text), text.path.name)["components"]["blade"]
    first = "elastic_properties_mb" in entry.value
    if first:
        elastic = entry["elastic_properties_mb"]["six_x_six"]
        axis, twist, unit = elastic["reference_axis"], elastic["twist"], 1.0
    else:
        elastic = entry["structure"]["elastic_properties"]
        axis, twist, unit = entry["reference_axis"], entry["outer_shape"]["twist"], math.pi / 180
    if part == "damping":
        mu = elastic["structural_damping"]["mu"].numbers()
        return Damping(tuple(mu[i].item() for i in ORDER))
    tables = [axis[x].table() for x in "xyz"]
    grid = torch.cat([places for places, _ in tables]).unique()
    points = torch.stack([Table(*table)(grid) for table in tables], -1)
    eta, sections = _sections_1(elastic) if first else _sections_2(elastic)
    turn = Table(*twist.table())(grid) * unit
    return Blade(points, turn, eta, sections, text.path.name)


def _loaded(text: Text) -> Any:
    try:
        import yaml
    except ImportError:
        raise ImportError("PyYAML is not installed; torchbeam[readers] is wanted") from None
    try:
        return yaml.load(text.whole, Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        at = len(text.lines) if mark is None else mark.line
        raise text.refusal(at, "a line that is no YAML", "YAML") from None


class _Entry:
    """A value of the file, which knows where it stands."""

    def __init__(self, value: Any, place: str) -> None:
        self.value, self.place = value, place

    def __getitem__(self, name: str) -> _Entry:
        if not isinstance(self.value, dict) or name not in self.value:
            raise refusal(f"{self.place} without {name!r}", "an entry of that name")
        return _Entry(self.value[name], f"{self.place}: {name}")

    def numbers(self, *shape: int) -> Tensor:
        """As a tensor (n, *shape)."""
        try:
            numbers = torch.tensor(self.value, dtype=torch.float64)
        except (TypeError, ValueError):
            numbers = torch.full((), math.nan)
        if numbers.shape[1:] != shape or numbers.ndim != 1 + len(shape):
            wanted = " of ".join(["a list", *(f"{n} numbers" for n in shape)])
            raise refusal(f"{self.place} = {shown(self.value)}", wanted)
        if not numbers.isfinite().all():
            raise refusal(f"{self.place} with NaN or infinity", "finite numbers", are=True)
        return numbers

    def table(self, *shape: int) -> tuple[Tensor, Tensor]:
        """Its grid (n,) and its values (n, *shape)."""
        grid, values = self["grid"].numbers(), self["values"].numbers(*shape)
        self.check_count(grid, values)
        return grid, values

    def check_count(self, grid: Tensor, values: Tensor) -> None:
        if len(grid) != len(values):
            given = f"{self.place} with {len(values)} values for {len(grid)} places"
            raise refusal(given, "one each")


def _sections_1(elastic: _Entry) -> tuple[Tensor, list]:
    """Version 1: the 21 numbers of the upper triangle at each station."""
    stiffness, mass = elastic["stiff_matrix"], elastic["inertia_matrix"]
    return _sections(
        *stiffness.table(len(UPPER)), *mass.table(len(UPPER)), stiffness.place, mass.place
    )


def _sections_2(elastic: _Entry) -> tuple[Tensor, list]:
    """Version 2: each entry along the blade, absent ones 0; of the mass, its centre and moments."""
    stiffness, mass = elastic["stiffness_matrix"], elastic["inertia_matrix"]

    def column(of: _Entry, name: str, default: Tensor) -> Tensor:
        numbers = of[name].numbers() if name in of.value else default
        of.check_count(default, numbers)
        return numbers

    grid = stiffness["grid"].numbers()
    K = torch.stack([column(stiffness, f"K{i + 1}{j + 1}", 0 * grid) for i, j in UPPER], -1)
    at = mass["grid"].numbers()
    m, x, y, edge, flap, polar, product = (column(mass, name, 0 * at) for name in INERTIA)
    entries = {(0, 0): m, (1, 1): m, (2, 2): m, (0, 5): -m * y, (1, 5): m * x, (2, 3): m * y,
               (2, 4): -m * x, (3, 3): edge, (4, 4): flap, (5, 5): polar,
               (3, 4): -product}  # fmt: skip
    M = torch.stack([entries.get(ij, 0 * m) for ij in UPPER], -1)
    return _sections(grid, K, at, M, stiffness.place, mass.place)


def _sections(
    eta: Tensor, K: Tensor, at: Tensor, M: Tensor, place: str, mass_place: str
) -> tuple[Tensor, list]:
    """Of upper triangles (n, 21) of the stiffness at eta, and of the mass `at` other places."""
    grid = torch.cat((eta, at)).unique()
    K, M = (Table(g, x, width=len(UPPER))(grid) for g, x in ((eta, K), (at, M)))
    sections = []
    for station, *rows in zip(grid.tolist(), K.tolist(), M.tolist(), strict=True):
        matrices = []
        for row, where in zip(rows, (place, mass_place), strict=True):
            full = [[0.0] * 6 for _ in range(6)]
            for (i, j), value in zip(UPPER, row, strict=True):
                full[i][j] = full[j][i] = value
            at_station = f"{where} at {station:g} that"
            check_matrix(full, lambda given, wanted, s=at_station: refusal(f"{s} {given}", wanted))
            matrices.append(reordered(full))
        try:
            sections.append(section_of(*matrices))
        except ValueError as error:
            raise ValueError(f"{place} at {station:g}: {error}") from None
    return grid, sections
