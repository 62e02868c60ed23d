"""Mode shapes: pictures and films of small motions about an equilibrium."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import count as check_count
from ..core.arguments import instance, number, tolerance
from ..core.validation import refusal
from ..linear.modes import Modes
from ..math import quaternions as quat
from ..scene.scene import Scene
from ..state.state import State
from .animation import animate
from .axis import axis_curves, nodes_of, rows_of
from .canvas import GREY, Axes, numbers
from .limits import even, extent, prepared
from .magnified import tilted

PERIOD = 2.0  # s, of the film of a mode
TURN = 0.5  # rad, the largest of a mode that hardly displaces the axis, in a film


def mode_shapes(
    state: Any,
    modes: Modes,
    ax: Axes | None = None,
    *,
    count: int = 4,
    scale: float = 0.15,
    plane: str | None = None,
) -> Axes:
    """The first `count` mode shapes about a state, both of one sample. The beam's axis moves by
    each mode at the instant of its largest displacement, `scale` times the structure's size. The
    legend has frequencies in Hz, or the rate in 1/s of a motion that does not oscillate. A mode
    that hardly displaces the axis (torsion) is named, not drawn.

    Raises:
        ValueError: for a batch, and as `shape`.

    Examples:
        >>> ax = tb.plot.mode_shapes(tb.rest(scene), tb.modes(tb.Scene(beam), count=3))
    """
    position, turn = nodes_of(state)
    check_count("count", count)
    moves, silent = _moves("mode_shapes", modes, position, number("scale", scale))
    move = torch.where(silent[:, None, None], 0.0, moves.real)[:count]
    at_rest = turn[..., 0]
    moved = position + move[..., :3]
    # a mode is linear in its size
    along = at_rest + torch.linalg.cross(move[..., 3:], at_rest.expand_as(moved))
    chord = torch.linalg.vector_norm(position.diff(dim=-2), dim=-1, keepdim=True)
    ax, seen = prepared(ax, plane, torch.cat((position, moved)))
    rows = rows_of(state)
    ax.plot(
        *numbers(axis_curves(rows, position, at_rest)[0][..., seen]).T, color=GREY, lw=1, ls="--"
    )
    for i, curve in enumerate(numbers(axis_curves(rows, moved, along, chord)[..., seen])):
        line = curve[:0] if silent[i] else curve
        turns = " (turns about its axis)" if silent[i] else ""
        label = f"{i + 1}: {_speed(modes.eigenvalue[i])}{turns}"
        ax.plot(*line.T, color=f"C{i}", lw=1.8, label=label)
    ax.legend(frameon=False, fontsize=8)
    return even(ax, seen)


def mode_film(
    modes: Modes,
    path: str | Path,
    ax: Axes | None = None,
    *,
    mode: int = 1,
    scale: float = 0.15,
    plane: str | None = None,
    scene: Scene | None = None,
    fps: float = 25.0,
    dpi: int = 100,
) -> Path:
    """Write a film of a mode about its equilibrium to a file. Returns the path. The film shows one
    period in two seconds, and repeats without a jump. A motion that does not oscillate grows.

    Args:
        modes: of one sample, with their equilibrium
        path: as in `animate`, as are ax, plane, scene, fps and dpi
        mode: its number, the slowest is 1
        scale: the largest displacement, as a share of the structure's size. A mode that hardly
            displaces the axis (torsion) turns by 0.5 rad at most, visible with a `scene`

    Raises:
        ValueError: for a batch, a number beyond the last mode, and as `animate`.

    Examples:
        >>> path = tb.plot.mode_film(tb.modes(scene, count=2), "second.gif", mode=2, fps=5)
    """
    instance("modes", modes, Modes)
    state, there = modes.state, modes.eigenvalue.shape[-1]
    if not isinstance(state, State):
        raise refusal("modes without their equilibrium", "what tb.modes returns", were=True)
    if check_count("mode", mode) > there:
        raise ValueError(f"mode = {mode} was given of {there} modes; one of them is wanted")
    position, turn = nodes_of(state)
    moves, _ = _moves("mode_film", modes, position, number("scale", scale))
    steps = torch.arange(max(round(PERIOD * tolerance("fps", fps)), 2)).to(position)
    phase = steps / len(steps)
    swing = torch.exp(2j * torch.pi * phase) if modes.eigenvalue[mode - 1].imag != 0 else phase
    move = (moves[mode - 1] * swing[:, None, None]).real
    film = replace(
        state.detach().broadcast((len(steps),)),
        position=position[0] + move[..., :3],
        rotation=tilted(turn[0] + quat.skew(move[..., 3:]) @ turn[0]),
    )
    ax, seen = prepared(ax, plane, film.position)
    plane = None if len(seen) == 3 else "".join("xyz"[i] for i in seen)
    ax.set_title(f"mode {mode}: {_speed(modes.eigenvalue[mode - 1])}", fontsize=9)
    return animate(film, path, ax, plane=plane, scene=scene, fps=fps, trail=False, dpi=dpi)


def _moves(call: str, modes: Modes, position: Tensor, scale: float) -> tuple[Tensor, Tensor]:
    """Moves (modes, N+1, 6) complex of nodes at position (1, N+1, 3), of which the real part is
    the largest; and which modes hardly displace the axis. Raises ValueError for a batch.
    """
    instance("modes", modes, Modes)
    if len(position) > 1 or modes.shape.ndim != 3:
        raise ValueError(
            f"modes or a state of more than one sample were given to {call}; one sample is wanted"
        )
    length = extent(position)
    moves = modes.shape.detach()
    flat = moves[..., :3].flatten(1)
    peak = flat.gather(1, flat.abs().argmax(-1, keepdim=True))[..., None]
    moves = moves * torch.exp(-1j * peak.angle())
    largest, most_turned = (
        torch.linalg.vector_norm(x, dim=-1).amax(-1) for x in moves.real.split(3, -1)
    )
    silent = largest < 1e-3 * length * most_turned
    by_turn = TURN / most_turned.clamp(min=1e-300)
    size = torch.where(silent, by_turn, scale * length / largest.clamp(min=1e-300))
    return moves * size[:, None, None], silent


def _speed(eigenvalue: Tensor) -> str:
    """Frequency, or the rate of what does not oscillate."""
    value = eigenvalue.detach()
    if value.imag != 0:
        return f"{value.imag.abs().item() / (2 * torch.pi):.4g} Hz"
    return f"{value.real.item():.3g} /s"
