"""Diagrams of section forces: normal and shear forces, torque and bending moments along beams."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize

from ..core.arguments import boolean, choice, instance, tolerance
from ..core.validation import refusal
from ..scene.scene import Scene
from ..sensors.section_forces import SectionForces
from .axis import POINTS, axis_curve, nodes_of, rows_of
from .canvas import GREY, Axes, is_3d, numbers, written_number
from .limits import even, extent, prepared
from .magnified import undeformed_state
from .shapes import EDGE_ON
from .symbols import Symbols

# Of a resultant: the section axis along which it is drawn, y or z, and to which side. Bending
# moments stand on the side that they stretch (strain = gamma + z kappa_2 - y kappa_3).
SIDES = {"F1": (2, 1), "F2": (1, 1), "F3": (2, 1), "M1": (2, 1), "M2": (2, 1), "M3": (1, -1)}
# As textbooks name them: where y lies in the plane, and where z does
NAMES = {"N": ("F1", "F1"), "V": ("F2", "F3"), "M": ("M3", "M2"), "T": ("M1", "M1")}
UPRIGHT = 0.1  # mean height of a normal: below it a beam has no lower side
FEW = 0.02  # of the largest value: what is less, or as near to another, is not written
LITTLE = 1e-3  # of it: a beam with less has no curve, and is written 0
OUTWARD, FONT = 5.0, 8.0  # points: from a curve to a value; of its letters
ROOM = 0.13, 0.05  # of the structure's size, beside a value and above it
NEAR = 0.06  # of the structure's size: values that are closer would cover each other
STRAIGHT = 0.05  # of its size: what is as flat stands along one axis
BESIDE = 0.06  # of its size: room at either end of that
# of the largest force, or of its moment across what is drawn, times the root of eps: what is less
# is what rounding leaves of zero
NOTHING = 10.0


def diagram(
    state: Any,
    resultant: str,
    ax: Axes | None = None,
    *,
    scene: Scene,
    inputs: dict[str, Any] | None = None,
    plane: str | None = None,
    height: float = 0.15,
    values: bool = True,
    symbols: bool = False,
) -> Axes:
    """Diagram of a stress resultant along all beams of one state, drawn from their axes.

    F1 is the normal force, F2 and F3 are shear forces (N). M1 is the torque, M2 and M3 are bending
    moments (N m). All are in section axes. N, V, M and T are those of textbooks, in a plane. V is
    positive where it turns a piece of the beam clockwise. M is positive where it stretches the
    lower side, of an upright beam the one on the right of its way. Bending moments stand on the
    side that they stretch. Positive N, V and T stand above, of an upright beam on the left of its
    way. Other forces and M1 stand on the side of z, F2 on that of y. A scene with `small=True` is
    drawn undeformed. A resultant that is rounding beside the others is zero. A beam with less than
    a thousandth of the largest value has no curve, and a 0. A structure along one axis fits the
    width, and leaves the other axis to the values, without metres.

    Args:
        state: one sample, of the nodal form
        resultant: "N", "V", "M", "T", or "F1" to "M3"
        scene: whose state it is; the loads along its beams count between nodes, by a parabola in
            each element (`SectionForces`). More elements follow loads that are not even.
        inputs: values of its inputs, by their names
        plane: "xy", "xz" or "yz", as in `shape`
        height: of the largest value, as a share of the structure's size
        values: write the values at ends of beams, at extremes, and on both sides of a jump
        symbols: of supports, joints and loads, see `symbols`

    Raises:
        ValueError: for a batch, bodies alone, a resultant of another name, and as `shape`.

    Examples:
        >>> ax = tb.plot.diagram(tb.equilibrium(scene), "M2", scene=scene)
    """
    name = choice("resultant", resultant, (*NAMES, *SIDES))
    instance("scene", scene, Scene)
    height, values = tolerance("height", height), boolean("values", values)
    boolean("symbols", symbols)
    position, axes = nodes_of(state)
    forces = _forces(state, scene, inputs, len(position))
    ax, seen = prepared(ax, plane, position)
    if scene.small:
        position, axes = nodes_of(undeformed_state(state, scene))
    resultant = _resultant(name, axes[0], seen)
    column, side = SIDES[resultant]
    if torch.linalg.vector_norm(axes[0, :, seen, column], dim=-1).max() < EDGE_ON:
        column = 3 - column  # the other one
    size = extent(position)
    told = _along(_clear(forces, resultant, size), scene.beam.order)
    most = told.abs().max().clamp(min=torch.finfo(told.dtype).tiny)
    scale, first = height * size / most, 0
    written: list[tuple[float, Tensor]] = []
    for row in rows_of(state):
        x, R = position[0, row], axes[0, row]
        value = told[first : first + len(x) - 1]
        first += len(x) - 1
        foot = _by_interval(axis_curve(x[None], R[None, :, :, 0])[0])
        way = _by_interval(axis_curve(R[None, ..., column], torch.zeros_like(x)[None])[0])
        drawn, sign = _signs(name, side, R[:, seen, 0], R[:, seen, column])
        top = foot + drawn * scale * value[..., None] * way
        foot, top, zero = foot[..., seen], top[..., seen], value.abs().max() <= LITTLE * most
        _draw(ax, foot, foot if zero else top)
        if values and zero:
            _value(ax, foot[len(foot) // 2, 0 if len(foot) % 2 == 0 else POINTS // 2], 0.0)
        elif values:
            _write(ax, foot, top, sign * value, FEW * most, written, size)
    if symbols:
        Symbols.of(ax, seen, scene, position, axes).draw(state, inputs)
    ax.set_title(f"{name} / {'N' if resultant[0] == 'F' else 'N m'}")
    even(ax, seen)
    _values_alone(ax, seen, position, size)
    return ax


def _forces(state: Any, scene: Scene, inputs: dict[str, Any] | None, samples: int) -> Tensor:
    """Section forces (N, 3, 6) of a state of so many samples; raises as `diagram`."""
    forces = SectionForces(scene, inputs=inputs)(state).detach()
    samples = max(samples, forces.shape[:-3].numel())
    if samples != 1:
        raise ValueError(f"{samples} samples were given to a diagram; one sample is wanted")
    if forces.numel() == 0:
        raise ValueError("bodies alone were given to a diagram; a scene with a beam is wanted")
    return forces.reshape(-1, 3, 6)


def _resultant(name: str, axes: Tensor, seen: list[int]) -> str:
    """Which one a name means in a picture of section axes (N+1, 3, 3). Raises ValueError for one of
    bending in space.
    """
    if name not in NAMES:
        return name
    if len(seen) == 3 and name in "VM":
        raise refusal(f"{name} of a structure in space", "F2, F3, M2 or M3")
    y, z = torch.linalg.vector_norm(axes[:, seen, 1:], dim=1).amax(0).tolist()
    return NAMES[name][z > y]


def _signs(
    name: str, side: int, way: Tensor, normal: Tensor
) -> tuple[Tensor | float, Tensor | float]:
    """Of a beam that goes and has its normals (N+1, 2 or 3) so: on which side of these values are
    drawn, and the sign that they are written with.
    """
    if name not in NAMES or way.shape[-1] == 3:
        return side, 1.0
    left = (way[:, 0] * normal[:, 1] - way[:, 1] * normal[:, 0]).mean()
    up = normal[:, 1].mean()
    up = (up if up.abs() > UPRIGHT else left).sign()
    if name == "M":
        return side, -side * up
    sign = -left.sign() if name == "V" else 1.0
    return sign * up, sign


def _by_interval(curve: Tensor) -> Tensor:
    """Points (n POINTS + 1, 3) of a curve -> of each interval between nodes (n, POINTS + 1, 3)."""
    return torch.cat((curve[:-1].unflatten(0, (-1, POINTS)), curve[POINTS::POINTS, None]), 1)


def _clear(forces: Tensor, resultant: str, size: float) -> Tensor:
    """Values (N, 3) of a resultant; zeros where none of them is clear of rounding."""
    told = forces[..., list(SIDES).index(resultant)]
    lever = size if resultant[0] == "F" else 1.0
    largest = torch.maximum(forces[..., :3].abs().max() * size, forces[..., 3:].abs().max())
    clear = told.abs().max() * lever > NOTHING * torch.finfo(told.dtype).eps ** 0.5 * largest
    return torch.where(clear, told, 0.0)


def _along(told: Tensor, order: int) -> Tensor:
    """Values (N, 3) at the start, the middle and the end of elements -> at the points of curves
    (intervals between nodes, POINTS + 1), along parabolas.
    """
    x = torch.linspace(-1, 1, order * POINTS + 1, dtype=told.dtype, device=told.device)
    shapes = torch.stack((x * (x - 1) / 2, 1 - x * x, x * (x + 1) / 2))
    return (told @ shapes).unfold(-1, POINTS + 1, POINTS).flatten(0, 1)


def _draw(ax: Axes, base: Tensor, top: Tensor) -> None:
    """The beam's axis, the curve (intervals, points, 2 or 3) where it is another, and lines from
    one to the other.
    """
    ax.plot(*numbers(base.flatten(0, 1)).T, color=GREY, lw=1.5)
    if top is base:
        return
    closed = torch.cat((base[:1, 0], top.flatten(0, 1), base[-1:, -1]))
    ax.plot(*numbers(closed).T, color="C0", lw=1.5)
    for foot, end in zip(base[:, ::2].flatten(0, 1), top[:, ::2].flatten(0, 1), strict=True):
        ax.plot(*numbers(torch.stack((foot, end))).T, color="C0", lw=0.5, alpha=0.5)


def _write(
    ax: Axes,
    base: Tensor,
    top: Tensor,
    value: Tensor,
    least: Tensor,
    written: list[tuple[float, Tensor]],
    size: float,
) -> None:
    """Values on both sides of a jump, each once where they stay, then at the ends of a beam and at
    its extremes, each once. They are not next to nothing, nor `written` at the same place by
    another beam; they are added to those.
    """
    beside = _jumps(base, value, least, size)
    base, top, value = base.flatten(0, 1), top.flatten(0, 1), value.flatten()
    own: list[int] = []
    others = tuple(written)
    extremes = int(value.argmax()), int(value.argmin())
    for k in dict.fromkeys((*beside, 0, len(value) - 1, *extremes)):
        number, there, outward = value[k].item(), top[k], top[k] - base[k]
        again = abs(number) <= least or any(
            abs(abs(number) - abs(other)) < least and (there - at).norm() < NEAR * size
            for other, at in others
        )
        for j in own:
            same = value[min(j, k) : max(j, k) + 1] if k in beside else value[j]
            again = again or bool((same - number).abs().max() <= least)
        if not again:
            own.append(k)
            written.append((number, there))
            if k in beside:  # away from the jump, too
                outward = normalize(outward, dim=0) + normalize(
                    base[k + beside[k]] - base[k], dim=0
                )
            _value(ax, there, number, outward, size)


def _jumps(base: Tensor, value: Tensor, least: Tensor, size: float) -> dict[int, int]:
    """The points before (-1) and behind (1) nodes where values (intervals, points) jump by more
    than `least`, the largest first, without those too near to one.
    """
    step, feet = (value[1:, 0] - value[:-1, -1]).abs(), base[1:, 0]
    nodes: list[int] = []
    for k in step.argsort(descending=True).tolist():
        if step[k] > least and all((feet[k] - feet[j]).norm() > NEAR * size for j in nodes):
            nodes.append(k)
    points = value.shape[1]
    return {(k + 1) * points + at: at or 1 for k in nodes for at in (-1, 0)}


def _value(
    ax: Axes, at: Tensor, number: float, outward: Tensor | None = None, size: float = 0.0
) -> None:
    """A number beside a point (2,) m, on the side of a way `outward`, with room by the structure's
    size; at a point (3,).
    """
    if is_3d(ax):
        ax.text(*at.tolist(), written_number(number), fontsize=FONT)
        return
    x = y = 0.0
    if outward is not None:
        x, y = (outward / outward.norm()).tolist()
        ax.update_datalim([(at[0] + ROOM[0] * size * x, at[1] + ROOM[1] * size * y)])
    ax.annotate(
        written_number(number),
        at.tolist(),
        (OUTWARD * x, OUTWARD * y),
        textcoords="offset points",
        fontsize=FONT,
        ha=_side(x, "left", "right"),
        va=_side(y, "bottom", "top"),
        bbox=dict(facecolor=ax.get_facecolor(), edgecolor="none", alpha=0.7, pad=0.5),
        annotation_clip=False,
    )


def _side(way: float, ahead: str, behind: str) -> str:
    """Where a text is held that lies beside a point."""
    return "center" if abs(way) < 0.4 else ahead if way > 0 else behind


def _values_alone(ax: Axes, seen: list[int], position: Tensor, size: float) -> None:
    """Without metres along the axis across what stands along the other: this goes from end to end
    with room, at even scales where the values need no more.
    """
    least, most = (
        numbers(end(position.flatten(0, -2), 0)[seen]) for end in (torch.amin, torch.amax)
    )
    flat = most - least < STRAIGHT * size
    if is_3d(ax) or not flat.any():
        return
    across = 1 if flat[1] else 0
    along, name = 1 - across, "xy"[across]
    limits, shape = ax.dataLim.get_points(), ax.bbox.size
    limits[0, along] = min(limits[0, along], least[along] - BESIDE * size)
    limits[1, along] = max(limits[1, along], most[along] + BESIDE * size)
    wide, high = limits[1, along] - limits[0, along], limits[1, across] - limits[0, across]
    more = max(0.0, wide * shape[across] / shape[along] - high) / 2
    limits[:, across] += -more, more
    ax.update_datalim(limits)
    ax.set_aspect("auto")
    ax.autoscale_view()
    ax.set(**{f"{name}label": "", f"{name}ticks": []})
