"""Campbell diagram of a rotor that spins on a support that does not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ..core.arguments import boolean, choice, instance, instant
from ..core.arguments import count as check_count
from ..core.derivatives import no_derivatives
from ..core.leaves import wants_gradient
from ..core.validation import as_tensor, concrete, finite, refusal, shown
from ..linear.bearing import Bearing
from ..linear.multiblade import SpinningModel, spinning_model
from ..linear.periodic import HARMONICS, NONE, ORDER, exponents, fastest
from ..linear.spinning import drawn, steady_spin
from ..linear.steady_check import check_steady
from ..linear.whirl import names_of, tracked, whirl
from ..math.eigen_derivatives import attach, upright
from ..math.quadratic_eigen import Pairs, slowest
from ..scene.effects import Inputs
from ..scene.in_double import in_double
from ..scene.scene import Scene
from ..uncertainty.evaluation import progress_of
from ..uncertainty.progress import Report
from .campbell_diagram import Campbell

METHODS = ("auto", "multiblade", "floquet")
SPARE = 4  # modes beyond those asked for, so that none is lost where they cross
# of an eigenvalue: what the azimuth changes of it where blades are equal
EQUAL = 1e-7
LEAST_STEPS = 8
ROOM = 20_000_000  # numbers of maps over a turn that are held at once


def campbell(
    scene: Scene,
    speeds: Any,
    *,
    bearing: int | Sequence[int] | None = None,
    held: bool = True,
    count: int = 6,
    method: str = "auto",
    steps: int = 32,
    t: float = 0.0,
    inputs: dict[str, Any] | None = None,
    progress: Report | bool | None = None,
) -> Campbell:
    """Frequencies and damping of a rotor on its support over the speed at which it spins.

    The rotor is all that hangs on the second part of a `Hinge`, the bearing. It spins at a
    speed; the support stands. Small motions are about the steady state: blades under their
    centrifugal loads, the support under the rotor's steady load.

    Args:
        scene: a structure in a frame at rest, drawn at the azimuth 0
        speeds: (n,) rad/s, rising, about the bearing's axis
        bearing: place of the hinge among the scene's joints; None = its only one. Several: the
            hinge, then further bearings of the rotor on its axis
        held: whether the speed is held, as by a stiff drive: the hinge's angle, torque and
            resistances do not count. Else the rotor turns freely beside its steady speed. Only the
            hinge's `damping` and the slope by the rate of a `Drive` as its torque resist that
        count: modes
        method: "multiblade": coordinates that do not spin, in which three and more equal blades
            have constant coefficients. "floquet": exponents over a turn, for two blades, unequal
            blades and shafts that are not round. "auto": multiblade where it is exact
        steps: of a turn, of "floquet"; their error is of sixth order
        t, inputs: of the loads, as in `equilibrium`
        progress: as in `monte_carlo`, of the speeds of "floquet"

    - **Frequencies** are those seen from the ground. Of two blades, of unequal ones, and of motions
      in which neighbours of an even number of blades move against each other, they are those of the
      harmonic that is largest in axes that turn with the blades.
    - **Loads** on the rotor must look the same from it at every azimuth: no gravity across the
      axis.
    - **Derivatives** by all that the scene holds and by the speeds, where eigenvalues are distinct.
    - **Cost.** Dense: O(n^3) of all coordinates a speed; "floquet" that for every step of a turn.

    Raises:
        ValueError: for a scene without such a bearing, a rotor that is held otherwise, loads that
            change with the azimuth, internal states of loads, unequal blades with
            method="multiblade", and steps too long for the modes asked for.
        RuntimeError: for a speed without a steady state.

    Examples:
        >>> disc = tb.Body(mass=2.0, inertia=(0.02, 0.01, 0.01), position=(1.0, 0, 0))
        >>> shaft = tb.Beam.straight(1.0, 4, tb.Section.circle(0.01, 210e9, 0.3, 7800.0))
        >>> journal = tb.Hinge(("shaft", -1), "disc", axis=(1, 0, 0))
        >>> held = tb.Support(("shaft", 0))
        >>> overhung = tb.Scene({"shaft": shaft, "disc": disc}, joints=[journal], supports=held)
        >>> diagram = tb.campbell(overhung, torch.linspace(0, 300, 4), count=4)
        >>> diagram.frequency.shape, diagram.names[:2]
        (torch.Size([4, 4]), ['backward 1', 'forward 1'])
    """
    instance("a scene", scene, Scene)
    choice("method", method, METHODS)
    check_count("count", count), check_count("steps", steps, LEAST_STEPS), boolean("held", held)
    speeds = _speeds(speeds, scene)
    values, time = scene.tensors(inputs), instant("t", t, scene.beam.nodes)

    def diagram(scene: Scene, _: None, speeds: Tensor, values: Inputs, time: Tensor) -> Campbell:
        return _diagram(
            scene, speeds, values, time, (bearing, held, count, method, steps, progress)
        )

    return in_double(diagram, scene, None, speeds, values, time)


def _speeds(speeds: Any, scene: Scene) -> Tensor:
    """(n, 1, ...) rad/s, before the scene's batch axes. Raises ValueError for other speeds, and a
    scene without a sample or with loads that remember.
    """
    if not scene.batch_shape.numel():
        empty = f"a scene with the batch axes {tuple(scene.batch_shape)}, without a sample,"
        raise refusal(empty, "one or more", are=True)
    if any(scene.internal_states):
        raise ValueError(
            "loads with internal states were given to campbell; ones without are wanted"
        )
    x = finite("speeds", as_tensor(speeds, scene.dtype, scene.device))
    if x.ndim != 1 or len(x) < 1 or bool(concrete(x[1:] <= x[:-1]).any()) or bool(x[0] < 0):
        raise refusal(f"speeds = {shown(speeds)}", "rising numbers (n,) from 0 on", are=True)
    return x.reshape(-1, *(1,) * len(scene.batch_shape))


def _diagram(
    scene: Scene, speeds: Tensor, values: Inputs, time: Tensor, options: tuple[Any, ...]
) -> Campbell:
    which, held, count, method, steps, progress = options
    bearing = Bearing.of(scene, which, held)
    start = drawn(bearing, speeds, time, values)
    check_steady(bearing, *start)
    problem, x, state = steady_spin(bearing, speeds, *start)
    check_steady(bearing, problem, x)
    spinning = spinning_model(bearing, problem, x, state, speeds)
    free = spinning.M.shape[-1]
    if count > free:
        raise refusal(f"count = {count}", f"at most {free}, all modes of the scene,")
    several = min(count + SPARE, free)
    M, D, K = spinning.constant()
    derivatives = wants_gradient(M, D, K)
    with no_derivatives():
        pairs = _finite(slowest(M, D, K, several, False, derivatives), count)
        periodic = _periodic(spinning, pairs.eigenvalue, pairs.right)
    unequal = bool(concrete(periodic > EQUAL).any())
    if unequal and method == "multiblade":
        raise ValueError(
            "method = 'multiblade' was given for a rotor whose coefficients change with the "
            f"azimuth, by {concrete(periodic).max().item():.1g} of an eigenvalue; three or more "
            "equal blades, or method='floquet', are wanted"
        )
    if method == "floquet" or unequal:
        method = "floquet"
        at_rest = pairs.eigenvalue, pairs.right
        value, shape, error = _floquet(
            spinning, at_rest, steps, min(count + SPARE, 2 * free), progress
        )
    else:
        method = "multiblade"
        value, shape = attach(M, D, K, pairs) if derivatives else (pairs.eigenvalue, pairs.right)
        value, shape = value[..., None], shape[..., None, :]
        error = torch.zeros_like(value.real)
    space, moves, shape = bearing.model.space, spinning.moves, shape.flatten(-3, -2)
    moves = moves.to(shape.dtype)
    with no_derivatives():
        nodal = (moves @ shape.mT).mT.unflatten(-1, (-1, space.unknowns))
        unit = bearing.model.unit[..., None, None, :]
        index = tracked(speeds.flatten(), value, (nodal / unit).flatten(-2), count)
    value, error = (x.flatten(-2).gather(-1, index) for x in (value, error))
    _refuse_few_steps(speeds, value, pairs.eigenvalue[..., :count], steps)
    shape = upright(shape.gather(-2, index[..., None].expand(*index.shape, shape.shape[-1])))[0]
    below = value.imag < 0
    value = torch.where(below, value.conj(), value)
    shape = torch.where(below[..., None], shape.conj(), shape)
    with no_derivatives():
        turning = whirl(spinning, shape)
        last = (-1, *(0,) * (turning.ndim - 2))
        names = names_of(bearing, spinning.at(last), shape[last])
    nodal = (moves @ shape.mT).mT.unflatten(-1, (-1, space.unknowns))
    if space.unknowns < 6:
        eye = torch.eye(space.unknowns, dtype=spinning.M.dtype, device=nodal.device)
        nodal = nodal @ space.embed(eye).to(nodal.dtype)
    return Campbell(speeds.flatten(), value, nodal, turning, names, error, method)


def _finite(pairs: Pairs, count: int) -> Pairs:
    """Those that all speeds and samples have: coordinates without inertia have none. ValueError
    where they are less than `count`.
    """
    known = int(concrete(torch.isfinite(pairs.eigenvalue)).sum(-1).min())
    if count > known:
        raise refusal(f"count = {count}", f"at most {known}, all modes of the scene,")
    parts = (x if x is None else x[..., :known] for x in pairs[3:])
    rows = (x if x is None else x[..., :known, :] for x in pairs[1:3])
    return Pairs(pairs.eigenvalue[..., :known], *rows, *parts)


def _refuse_few_steps(speeds: Tensor, value: Tensor, near: Tensor, steps: int) -> None:
    """ValueError where steps of a turn do not tell all modes (n, ..., count); near: about these."""
    none = concrete((value.detach().abs() > abs(NONE) / 2).flatten(1).any(-1))
    if none.any():
        slow = concrete(speeds).flatten()[none].min().item()
        turns = (concrete(near).abs() / concrete(speeds)[..., None])[none].max().item()
        wanted = max(2 * steps, math.ceil(turns * steps / fastest(torch.ones(()), steps).item()))
        modes = f"{near.shape[-1]} modes at {slow:g} rad/s"
        raise refusal(
            f"steps = {steps} of a turn for {modes}", f"steps = {wanted} or fewer modes", are=True
        )


def _periodic(spinning: SpinningModel, value: Tensor, right: Tensor) -> Tensor:
    """(...) of an eigenvalue: the most that coefficients that change with the azimuth would move
    one, or couple two.
    """
    (M, D, _), W = spinning.constant(), spinning.speed[..., None, None]
    v, by = right.mT, value[..., None, :]
    slope = ((v.conj() * (2 * by * (M.to(v.dtype) @ v) + D.to(v.dtype) @ v)).sum(-2)).abs()
    size = (slope[..., :, None] * slope[..., None, :]).sqrt()
    most = torch.zeros_like(value.real[..., 0])
    at = torch.tensor((0.7, 1.9), dtype=most.dtype, device=most.device)
    change = (A - B for A, B in zip(spinning.periodic(at), spinning.constant(), strict=True))
    for M, D, K in zip(*change, strict=True):
        M, D, K = (A.to(v.dtype) for A in (M, D, K))
        coupling = (v.mH @ (K @ v + by * (D @ v) + by**2 * (M @ v))).abs()
        share = coupling / size / torch.maximum(by.abs(), W)
        share = torch.where(torch.isfinite(share), share, 0.0)
        most = torch.maximum(most, share.amax((-1, -2)))
    return most


def _floquet(
    spinning: SpinningModel, at_rest: tuple[Tensor, Tensor], steps: int, count: int, progress: Any
) -> tuple[Tensor, Tensor, Tensor]:
    """Exponents (n, ..., m, h), shapes, and the error 1/s of the steps, by the largest harmonics of
    each motion; at_rest: eigenvalues and shapes where nothing turns.
    """
    n, more = spinning.M.shape[-1], count - at_rest[0].shape[-1]
    report = progress_of(progress, len(spinning.speed))
    first = int((concrete(spinning.speed.flatten())[:1] == 0).sum())  # speeds rise
    value, shape = at_rest[0][:first], at_rest[1][:first]
    value = torch.cat(
        (value, torch.full_like(value[..., :1], NONE).expand(*value.shape[:-1], more)), -1
    )
    value, shape = value[..., None], pad(shape, (0, 0, 0, more))[..., None, :]
    value, shape = (
        value.expand(*value.shape[:-1], HARMONICS),
        shape.repeat_interleave(HARMONICS, -2),
    )
    results = [(value, shape, torch.zeros_like(value.real))] if first else []
    size = spinning.speed[0].numel() * steps * 4 * n**2
    at_once = max(1, ROOM // size)
    for k in range(first, len(spinning.speed), at_once):
        some = spinning.at(slice(k, k + at_once))
        of, limit = (some.periodic, some.speed), fastest(some.speed, steps)
        value, shape = exponents(*of, steps, count, limit)
        with no_derivatives():
            coarse = exponents(*of, steps // 2, count, limit).exponent.flatten(-2)
            apart = (value[..., :1] - coarse[..., None, :]).abs().amin(-1, keepdim=True)
            error = apart.expand(value.shape) / (2**ORDER - 1)
        results.append((value, shape, error))
        if report is not None:
            report.add(len(value), 0, False)
    return tuple(torch.cat(x) for x in zip(*results, strict=True))
