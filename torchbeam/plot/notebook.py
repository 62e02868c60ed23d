"""What a notebook shows of a scene, a state, a solution or modes: a picture beside a table."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import Any

import torch

from ..linear.modes import Modes
from ..scene.scene import Scene
from ..state.instant import Instant
from ..state.reduced import ReducedStates
from ..state.solution import Solution
from ..state.state import State, rest
from .axis import PLANES, nodes_of
from .canvas import Axes
from .limits import prepared
from .mode_shapes import mode_shapes
from .obstacles import obstacles
from .shapes import shape
from .tendons import tendons

SHAPES = 8  # at most so many in a picture
DPI = 80
LEFT = ' style="text-align: left"'


def in_html(value: Any) -> str:
    """The picture and the table, of what has a `summary`. A motion is drawn at some instants, a
    batch by some samples, the first darkest.
    """
    rows = "".join(
        f"<tr><th{LEFT}>{escape(name)}</th><td{LEFT}>{escape(text)}</td></tr>"
        for name, text in value.summary.items()
    )
    picture = _picture(value)
    seen = f'<img alt="shape" src="data:image/png;base64,{picture}">' if picture else ""
    return (
        '<div style="display: flex; align-items: center; gap: 1em">'
        f"{seen}<table><caption>{type(value).__name__}</caption>{rows}</table></div>"
    )


@torch.no_grad()
def _picture(value: Any) -> str | None:
    """PNG in base64; None without matplotlib, and where there are no numbers to draw (of no
    samples, infinite, or within torch.func).
    """
    try:
        states = _states(value)
        if states is None:
            return None
        nodes = states.nodes.flatten(0, -2)
        if nodes.isinf().any() or nodes.isnan().all(0).any():
            return None
        figure = _drawn(value, states).figure
        file = io.BytesIO()
        figure.savefig(file, dpi=DPI, format="png")
    except (ImportError, RuntimeError):
        return None
    return base64.b64encode(file.getvalue()).decode()


def _drawn(value: Any, states: Any) -> Axes:
    """Its picture, with the states that are drawn."""
    if isinstance(value, Modes):
        first = value.eigenvalue.reshape(-1, value.eigenvalue.shape[-1])[0]
        shapes = value.shape.reshape(-1, *value.shape.shape[-3:])[0]
        return mode_shapes(states, Modes(first, shapes))
    return _of_scene(value, states) if isinstance(value, Scene) else shape(states)


def _states(value: Any) -> Any:
    """Those that are drawn, None = there are none: of modes the first sample's equilibrium."""
    if isinstance(value, Modes):
        state = None if value.state is None or not len(value.shape) else value.state.broadcast()
        while state is not None and state.batch_shape:
            state = state[0]
        return state
    if isinstance(value, Scene):
        return _samples(rest(value))
    return _instants(value) if isinstance(value, Solution) else _samples(value)


def _of_scene(scene: Scene, state: State) -> Axes:
    """As drawn, with tendons and, in a plane, obstacles."""
    eyelets = [rope.at(state.position, state.rotation) for rope in scene.tendons]
    points = [x.flatten(0, -2) for x in (nodes_of(state)[0], *eyelets)]
    ax, seen = prepared(None, None, torch.cat(points)[None])
    plane = next((name for name, pair in PLANES.items() if list(pair) == seen), None)
    shape(state, ax, plane=plane)
    if scene.tendons:
        tendons(scene, state, ax, plane=plane)
    return ax if plane is None else obstacles(scene, ax, plane=plane)


def _samples(state: Instant) -> Any:
    """Some of a batch."""
    state = state.broadcast() if isinstance(state, State) else state
    while len(state.batch_shape) > 1 and len(state.nodes):
        state = state[0]
    return state[_spread(state.batch_shape[0])] if state.batch_shape else state


def _instants(solution: Solution) -> Any:
    """Some of a motion: of a batch the first sample's."""
    index, states = _spread(len(solution.t)), solution.states
    some = states.some(index) if isinstance(states, ReducedStates) else states[index]
    while len(some.batch_shape) > 1 and some.nodes.numel():
        some = some[:, 0]
    return some


def _spread(count: int) -> torch.Tensor:
    """At most SHAPES places of `count`, first and last among them."""
    return torch.linspace(0, count - 1, min(count, SHAPES)).round().long()
