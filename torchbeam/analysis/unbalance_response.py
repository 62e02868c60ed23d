"""Response of a spinning rotor to its unbalance, over the speed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import instance, instant
from ..core.validation import as_tensor, axis_last, concrete, finite, refusal, shown
from ..linear.bearing import ON_AXIS, Axis, Bearing
from ..linear.spinning_modes import EQUAL, constant_modes
from ..math.dense import solve_unchecked
from ..scene.effects import Inputs
from ..scene.in_double import in_double
from ..scene.scene import Scene
from .campbell import Spin, speeds_of, spin_of


def unbalance_response(
    scene: Scene,
    speeds: Any,
    unbalance: Mapping[Any, Any],
    *,
    bearing: int | Sequence[int] | None = None,
    t: float = 0.0,
    inputs: dict[str, Any] | None = None,
) -> Tensor:
    """Amplitudes of the synchronous motion of a rotor and its support under unbalance.

    Unbalance is mass times eccentricity. At the speed W its force U W^2 turns with the rotor. The
    motion is small, about the steady spin of a balanced rotor, as in `campbell`: gyroscopic
    moments, damping, and supports that differ by direction count.

    Args:
        scene: as of `campbell`
        speeds: (n,) rad/s, rising, about the bearing's axis
        unbalance: node of the rotor on its axis -> (..., 3) kg m, in frame a at t = 0. The part
            across the axis counts
        bearing: as of `campbell`
        t, inputs: of the loads, as in `equilibrium`

    Returns:
        (n, ..., nodes, 6) complex: displacement (m) and rotation (rad) of the nodes in frame a,
        the real part of amplitude times exp(i W t). For an axis along x |y + i z|/2 is the forward
        whirl, |y - i z|/2 the backward one. Blades move so at the azimuth 0.

    Raises:
        ValueError: for a scene without such a bearing, a node that is not on the axis of the rotor,
            loads that change with the azimuth, and a rotor that looks different from different
            sides: two blades, a shaft that is not round.
        RuntimeError: for a speed without a steady state.

    Examples:
        >>> disc = tb.Body(mass=2.0, inertia=(0.02, 0.01, 0.01), position=(1.0, 0, 0))
        >>> shaft = tb.Beam.straight(1.0, 4, tb.Section.circle(0.01, 210e9, 0.3, 7800.0))
        >>> journal = tb.Hinge(("shaft", -1), "disc", axis=(1, 0, 0))
        >>> held = tb.Support(("shaft", 0))
        >>> overhung = tb.Scene({"shaft": shaft, "disc": disc}, joints=[journal], supports=held)
        >>> motion = tb.unbalance_response(overhung, [30.0, 60.0], {"disc": (0, 1e-4, 0)})
        >>> motion.shape, motion[:, overhung.beam.row("disc"), 1].abs().tolist()  # m, along y
        (torch.Size([2, 6, 6]), [3.3252e-05, 8.4351e-05])
    """
    instance("a scene", scene, Scene)
    speeds = speeds_of(speeds, scene)
    values, time = scene.tensors(inputs), instant("t", t, scene.beam.nodes)
    if not isinstance(unbalance, Mapping) or not unbalance:
        raise refusal(f"unbalance = {shown(unbalance)}", "node -> (..., 3) kg m")
    vectors = {scene.beam.row(k): _vector(scene, k, v) for k, v in unbalance.items()}

    def response(
        scene: Scene, _: None, speeds: Tensor, values: Inputs, time: Tensor, vectors: Any
    ) -> Tensor:
        return _response(spin_of(Bearing.of(scene, bearing), speeds, values, time), vectors)

    return in_double(response, scene, None, speeds, values, time, vectors)


def _vector(scene: Scene, node: Any, value: Any) -> Tensor:
    vector = finite("unbalance", as_tensor(value, scene.dtype, scene.device))
    return axis_last(f"unbalance of {node!r}", vector, 3)


def _response(spin: Spin, vectors: dict[int, Tensor]) -> Tensor:
    """(n, ..., nodes, 6) of unbalance (..., 3) kg m by rows of nodes."""
    if spin.unsteady is not None:
        raise ValueError(
            f"{spin.unsteady} was given to unbalance_response; loads that turn with the rotor, or "
            "act along its axis, are wanted, and unbalance= alone"
        )
    bearing, spinning, state = spin.bearing, spin.model, spin.state
    space = bearing.model.space
    axis = bearing.axis(space.to_reduced(state))
    _refuse_off_axis(bearing, axis, state.position, vectors)
    if spinning.mechanical.M.shape[-1] and constant_modes(spinning, 1)[1] > EQUAL:
        raise ValueError(
            "a rotor that looks different from different sides was given to unbalance_response; "
            "a round one, or three or more equal blades, is wanted"
        )
    speed = spinning.speed[..., None, None]
    moves = spinning.moves.unflatten(-2, (spinning.nodes, space.unknowns))
    force: Tensor | float = 0.0
    for row, vector in vectors.items():
        ahead = torch.linalg.cross(*torch.broadcast_tensors(axis.direction, vector))
        across = -torch.linalg.cross(*torch.broadcast_tensors(axis.direction, ahead))
        turning = torch.complex(*(space.project_vector(v) for v in (across, -ahead)))
        by = moves[..., row, : turning.shape[-1], :].mT.to(turning.dtype)
        force = force + by @ turning[..., None]
    M, D, K = spinning.constant()
    stiffness = torch.complex(K - speed**2 * M, speed * D)
    move = solve_unchecked(stiffness, speed**2 * force)
    return space.embed((moves.to(move.dtype) @ move[..., None, :, :])[..., 0])


def _refuse_off_axis(bearing: Bearing, axis: Axis, position: Tensor, rows: Iterable[int]) -> None:
    """ValueError for nodes that are not on the axis of the rotor."""
    extent = concrete(bearing.model.scene.beam.extent).detach()
    for row in rows:
        apart = position[..., row, :] - axis.point
        off = torch.linalg.cross(*torch.broadcast_tensors(apart, axis.direction))
        far = concrete(off).detach().abs().amax(-1) > ON_AXIS * extent
        if not bearing.rotor[row] or bool(far.any()):
            raise refusal(f"unbalance of {row!r}", "a node of the rotor, on its axis")
