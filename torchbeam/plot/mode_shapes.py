"""Mode shapes: pictures and films of small motions about an equilibrium."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import count as check_count
from ..core.arguments import instance, number, tolerance
from ..core.validation import refusal, shown
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


def orbits(
    state: Any,
    motion: Tensor,
    ax: Axes | None = None,
    *,
    scale: float = 0.15,
    plane: str | None = None,
) -> Axes:
    """Orbits of the nodes of a rotor about a state of one sample, and its axis at their beginning.

    Args:
        state: where the rotor stands, as `tb.rest(scene)`
        motion: (nodes, 6) complex, a shape of `Campbell` or of `unbalance_response`: the nodes move
            by the real part of motion times exp(i phase)
        ax, plane: as in `shape`
        scale: the largest displacement, as a share of the size of all

    An orbit begins with a dot, and runs through nine tenths of a turn.

    Raises:
        ValueError: for a batch, a motion of another shape, and as `shape`.

    Examples:
        >>> disc = tb.Body(mass=2.0, inertia=(0.02, 0.01, 0.01), position=(1.0, 0, 0))
        >>> shaft = tb.Beam.straight(1.0, 4, tb.Section.circle(0.01, 210e9, 0.3, 7800.0))
        >>> journal = tb.Hinge(("shaft", -1), "disc", axis=(1, 0, 0))
        >>> held = tb.Support(("shaft", 0))
        >>> overhung = tb.Scene({"shaft": shaft, "disc": disc}, joints=[journal], supports=held)
        >>> diagram = tb.campbell(overhung, [100.0], count=2)
        >>> ax = tb.plot.orbits(tb.rest(overhung), diagram.shape[0, 1])  # forward
    """
    position, turn = nodes_of(state)
    if not isinstance(motion, Tensor) or motion.shape != (position.shape[-2], 6):
        wanted = f"({position.shape[-2]}, 6), of one speed and one mode,"
        raise refusal(f"motion = {shown(motion)}", wanted)
    if len(position) > 1:
        raise refusal("a state of more than one sample", "one sample", were=True)
    phase = torch.linspace(0, 0.9 * 2 * torch.pi, 61).to(position)[:, None, None]
    move = (motion.detach() * torch.exp(1j * phase)).real.to(position)
    largest = torch.linalg.vector_norm(move[..., :3], dim=-1).max().clamp(min=1e-300)
    move = move * (number("scale", scale) * extent(position) / largest)
    moved, at_rest = position + move[..., :3], turn[..., 0]
    along = at_rest[0] + torch.linalg.cross(move[0, :, 3:], at_rest[0])
    ax, seen = prepared(ax, plane, torch.cat((position, moved)))
    rows, chord = rows_of(state), torch.linalg.vector_norm(position.diff(dim=-2), dim=-1)
    for at, tangent, look in ((position, at_rest, "--"), (moved[:1], along[None], "-")):
        curve = axis_curves(rows, at, tangent, chord[..., None])[0]
        ax.plot(*numbers(curve[..., seen]).T, color=GREY if look == "--" else "C0", ls=look)
    for orbit in numbers(moved[..., seen]).swapaxes(0, 1):
        ax.plot(*orbit.T, color="C3", lw=1)
        ax.plot(*orbit[:1].T, "o", color="C3", ms=3)
    return even(ax, seen)


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
