"""Elements that a shape bends or stretches further than their mesh or a beam's theory goes."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor
from torch._C import _functorch as functorch

from ..core.derivatives import no_derivatives
from ..core.status import named
from ..core.validation import concrete
from ..core.warning import warn
from .model import Model

# rad, of an element: of an arc whose chord is 2.6 % shorter than it (1 - sin(a/2)/(a/2))
BENT = 0.8
BROKEN = 2.0  # rad: next to half a turn, which an element of two nodes cannot pass
SURELY = 0.5  # times these, from node to node: no station within has more
STRETCHED = 10.0  # times its length, which no solid bears


def deformations(model: Model, position: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor]:
    """At the stations of elements, nodes in the space's coordinates: (..., N) rad by which each
    element is bent from the undeformed beam, without its twist, which it has exactly; (..., N) its
    length over that at rest.
    """
    strain, p = model.strain(model.kinematics(position, rotation)), model.space.dims.position
    bend = model.space.order * (model.length * strain)[..., p + p // 3 :]  # without the twist
    rest = model.reference[..., :p]
    lengths = [torch.linalg.vector_norm(v, dim=-1) for v in (strain[..., :p] + rest, rest)]
    return torch.linalg.vector_norm(bend, dim=-1), lengths[0] / lengths[1]


def suspects(model: Model, position: Tensor, rotation: Tensor) -> np.ndarray:
    """(...) bool: which shapes may have such an element, by the turns and distances of neighbouring
    nodes, without an operation of torch: all others are surely without.
    """
    beam = model.scene.beam
    if not (model.space.turns and model.station_count):
        return np.zeros(position.shape[:-2], dtype=bool)
    if functorch.peek_interpreter_stack() is not None:  # where numbers are not to be had
        return np.ones(position.shape[:-2], dtype=bool)
    x, q, nodes, frames = map(_array, (position, rotation, beam.nodes, beam.frames))
    # a turn from the one drawn is at most as large as both together
    half = np.maximum(SURELY * BENT / 2 - np.arccos(_cosine(frames)), 0.0)
    apart, drawn = (np.square(np.diff(v, axis=-2)).sum(-1) for v in (x, nodes))
    far = (_cosine(q) < np.cos(half)) | (apart > (SURELY * STRETCHED) ** 2 * drawn)
    if beam.parts:  # between parts there is no element
        rows = [k for p in beam.parts for k in range(p.nodes.start, p.nodes.stop - 1)]
        far = far[..., rows]
    return far.any(-1)


def _array(x: Tensor) -> np.ndarray:
    x = x.detach() if x.requires_grad else x
    return (x if x.device.type == "cpu" else x.cpu()).numpy()


def _cosine(q: np.ndarray) -> np.ndarray:
    """(..., N) of half the angle between neighbours of rotations (..., N+1, 4), or in a plane."""
    return np.minimum(np.abs((q[..., 1:, :] * q[..., :-1, :]).sum(-1)), 1.0)


def too_deformed(
    model: Model,
    position: Tensor,
    rotation: Tensor,
    judged: Tensor,
    bent: float = BENT,
    t: Tensor | None = None,
) -> str | None:
    """A sentence on the element of the samples `judged` (...) that is stretched STRETCHED times or,
    where none is, on the one that bends most, by more than `bent` rad; None where there is none.
    t: of a trajectory, whose first axis is time. Small rotations are as large as their loads.
    """
    if not (model.space.turns and model.station_count):
        return None
    with no_derivatives():
        bend, stretch = (
            concrete(torch.where(judged[..., None], v, 0.0))
            for v in deformations(model, position, rotation)
        )
        if bool((far := stretch > STRETCHED).any()):
            return (
                f"{_where(model, stretch, far, t)} is stretched to {stretch.max().item():.2g} "
                "times its length: are stiffness and loads in the same units (Pa, m, N)?"
            )
        order = model.space.order
        if bool((far := bend > order * bent).any()):
            finer = "" if order > 1 else ", or those of order 2"
            return (
                f"{_where(model, bend, far, t)} bends by {bend.max().item():.2g} rad; more "
                f"elements there are wanted{finer}"
            )
    return None


def unsteppable(
    model: Model, position: Tensor, rotation: Tensor, judged: Tensor, t: Tensor | None = None
) -> str | None:
    """The same of what no step can pass, where steps have failed."""
    sentence = too_deformed(model, position, rotation, judged, BROKEN, t)
    return sentence and f"{sentence}: no step is short enough for it"


def warn_of_deformed(
    model: Model, position: Tensor, rotation: Tensor, judged: Tensor, t: Tensor | None = None
) -> None:
    """Warns of it: see `too_deformed`."""
    if not suspects(model, position, rotation).any():
        return
    if (sentence := too_deformed(model, position, rotation, judged, t=t)) is not None:
        warn(f"{sentence} (the answer may be far off)")


def _where(model: Model, x: Tensor, far: Tensor, t: Tensor | None) -> str:
    """The element where x (..., N) is largest, which samples are `far`, since when, in words."""
    station, beam = int(x.reshape(-1, x.shape[-1]).amax(0).argmax()), model.scene.beam
    part = next((p for p in beam.parts if p.stations.start <= station < p.stations.stop), None)
    first, of = (0, "") if part is None else (part.first_station, f" of {part.name!r}")
    samples, since = far.any(-1), ""
    if t is not None:
        begun = int(samples.reshape(len(t), -1).any(-1).long().argmax())
        samples, since = samples.any(0), f", at t = {t[begun].item():.6g} s and later"
    which = f", {named(samples)}" if samples.ndim else ""
    return f"element {(station - first) // beam.order}{of}{which}{since}{',' * bool(which + since)}"
