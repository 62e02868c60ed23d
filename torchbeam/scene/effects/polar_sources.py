"""Where polars come from: plates beyond stall, files, and a network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...core.validation import Value, as_tensor, refusal
from ...math.shapes import stacked

Curves = tuple[Tensor, Tensor, Tensor]  # cl, cd, cm
FLAT = 50.0  # aspect ratio from which the drag of a plate across the wind is that of an endless one
BACK = 0.7  # of the lift with the trailing edge first, over that with the leading edge
SPACING = math.radians(10.0)  # of places that an extension adds, at most


def up_to_half_a_turn(a: Tensor, curves: Curves, aspect_ratio: float) -> tuple[Tensor, ...]:
    """Angles (n,) and curves cl, cd, cm (..., n), see `Polar.extended`."""
    right, (cl, cd, cm) = math.pi / 2, curves
    if not (-right < a[0] < 0 < a[-1] < right):
        raise refusal("a Polar whose table does not lie about 0, within a right angle,", "one")
    most = 2.01 if aspect_ratio >= FLAT else 1.11 + 0.018 * aspect_ratio
    most = torch.maximum(cd.amax(-1), torch.full_like(cd[..., 0], most))
    above = _past(a[-1], *(x[..., -1] for x in curves), most)
    below = _past(-a[0], -cl[..., 0], cd[..., 0], -cm[..., 0], most)
    below = tuple(sign * x.flip(-1) for sign, x in zip((-1, -1, 1, -1), below, strict=True))
    return tuple(stacked(*x, axis=-1) for x in zip(below, (a, *curves), above, strict=True))


def _past(
    start: Tensor, cl: Tensor, cd: Tensor, cm: Tensor, most: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Angles (k,) beyond `start` up to half a turn, and cl, cd, cm (..., k) there, which begin at
    these (...).
    """
    right = math.pi / 2

    def spread(first: float, last: float) -> Tensor:
        return torch.linspace(first, last, 1 + math.ceil((last - first) / SPACING)).to(start)

    ahead = spread(start.item(), right)
    back = spread(right, math.pi - start.item())[1:]
    a = torch.cat((ahead, back, start.new_tensor([math.pi])))
    mirrored = torch.cat((ahead, math.pi - back, start[None]))
    sin, cos = mirrored.sin(), mirrored.cos()
    A2 = (cl - most * sin[0] * cos[0]) * sin[0] / cos[0] ** 2
    B2 = (cd - most * sin[0] ** 2) / cos[0]
    B1 = most[..., None]
    lift = B1 / 2 * (2 * mirrored).sin() + A2[..., None] * cos**2 / sin
    drag = B1 * sin**2 + B2[..., None] * cos
    lift = lift * torch.where(a > right, -BACK, 1.0)
    lift = lift * torch.where(a == a[-1], 0.0, 1.0)
    normal = lift * a.cos() + drag * a.sin()
    # where the normal force acts, behind the quarter chord
    arm = -cm / normal[..., 0]
    share = (a - a[0]) / (right - a[0])
    past = 0.25 + 0.25 * (a - right) / right
    arms = torch.where(a <= right, arm[..., None] * (1 - share) + 0.25 * share, past)
    return tuple(x[..., 1:] for x in (a, lift, drag, -arms * normal))


def read(path: Path) -> tuple[Tensor, ...]:
    """Angles, cl, cd and, if there is one, cm of a file, see `Polar.read`."""
    runs: list[list[list[float]]] = [[]]
    header = ""
    for line in path.read_text(errors="replace").splitlines():
        row = _numbers(line)
        if len(row) < 3:
            header = line if "CDp" in line else header
            runs.append([])
        else:
            if runs[-1] and len(runs[-1][-1]) != len(row):
                runs.append([])
            runs[-1].append(row)
    rows = max(runs, key=len)
    if len(rows) < 2:
        raise refusal(f"{path.name}, which holds no rows of angle, cl and cd,", "a polar's file")
    columns = torch.tensor(rows, dtype=torch.float64).T
    picked = (0, 1, 2, 4) if header and len(columns) > 4 else (0, 1, 2, 3)
    degrees, cl, cd, *cm = (columns[k] for k in picked if k < len(columns))
    order = degrees.argsort()
    return torch.deg2rad(degrees[order]), *(x[order] for x in (cl, cd, *cm))


def _numbers(line: str) -> list[float]:
    """A row of numbers; none of a line that holds anything else."""
    try:
        return [float(word) for word in line.replace(",", " ").split()]
    except ValueError:
        return []


def from_network(
    aerofoil: Any, reynolds: float, alpha: Value | None, model: str, options: dict[str, Any]
) -> tuple[Tensor, ...]:
    """Angles, cl, cd and cm, see `Polar.neuralfoil`."""
    try:
        import aerosandbox
        import neuralfoil
    except ImportError as error:
        raise ImportError(
            "Polar.neuralfoil needs NeuralFoil: pip install torchbeam[air]"
        ) from error
    if alpha is None:
        degrees = torch.arange(-15.0, 21.0, dtype=torch.float64)
    else:
        degrees = torch.rad2deg(as_tensor(alpha, torch.float64))
    if isinstance(aerofoil, (str, Path)):
        foil = aerosandbox.Airfoil(str(aerofoil))
    else:
        foil = aerosandbox.Airfoil("given", coordinates=torch.as_tensor(aerofoil).numpy())
    result = neuralfoil.get_aero_from_airfoil(
        foil, alpha=degrees.numpy(), Re=float(reynolds), model_size=model, **options
    )
    curves = (torch.as_tensor(result[name], dtype=torch.float64) for name in ("CL", "CD", "CM"))
    return torch.deg2rad(degrees), *curves
