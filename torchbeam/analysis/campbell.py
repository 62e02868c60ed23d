"""Campbell diagram of a rotor that spins on a support that does not."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, instance, instant
from ..core.arguments import count as check_count
from ..core.derivatives import no_derivatives
from ..core.leaves import wants_gradient
from ..core.validation import as_tensor, concrete, finite, refusal, shown
from ..linear.bearing import Bearing
from ..linear.multiblade import SpinningModel, spinning_model
from ..linear.periodic import NONE, Exponents, fastest
from ..linear.periodic_orbit import orbit_exponents
from ..linear.spinning import drawn, steady_spin
from ..linear.spinning_modes import (
    EQUAL,
    SpinningModes,
    constant_modes,
    floquet_modes,
    multiblade_modes,
    orbit_steps,
)
from ..linear.steady_check import refuse_own_axes, unsteady
from ..linear.whirl import Motions, names_of, relaxing, tracked, whirl
from ..math.eigen_derivatives import upright
from ..scene.effects import Inputs
from ..scene.in_double import in_double
from ..scene.scene import Scene
from ..state.state import State, rest
from ..uncertainty.evaluation import progress_of
from ..uncertainty.progress import Report
from .campbell_diagram import Campbell
from .onset import Ranges, unstable_between

METHODS = ("auto", "multiblade", "floquet")
LEAST_STEPS = 8
ONSET = {"multiblade": 1e-6, "floquet": 1e-3}  # of a speed: how far that of an onset is searched


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
    speed; the support stands. Small motions are about the steady state, blades under their
    centrifugal loads and the support under the rotor's, or about a periodic orbit.

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
        steps: of a turn, of "floquet"; their error is of sixth order. A periodic orbit takes four
            times as many, of fourth order
        t, inputs: of the loads, as in `equilibrium`
        progress: as in `monte_carlo`, of the speeds of "floquet"

    - **Frequencies** are those seen from the ground. Of two blades, of unequal ones, and of motions
      in which neighbours of an even number of blades move against each other, they are those of the
      harmonic that is largest in axes that turn with the blades.
    - **Loads** that change with the azimuth, as gravity across the axis, and a rotor out of balance
      make a periodic orbit, about which small motions are then. It is found by "floquet", of a
      speed that is held, and has no derivatives.
    - **Relaxing** motions decay without oscillating. They are left out as far as there are others,
      and come last. Such are overdamped ones, and those of the internal states of loads and of
      `Viscoelastic`.
    - **Growth** beyond `count` is told too, by `growth` and `unstable_ranges`.
    - **Derivatives** by all that the scene holds and by the speeds, where eigenvalues are distinct.
    - **Cost.** Dense: O(n^3) of all coordinates a speed; "floquet" that for every step of a turn.

    Raises:
        ValueError: for a scene without such a bearing, a rotor that is held otherwise, a part that
            nothing holds, and a `Load` with batch axes of its own. With method="multiblade", for
            loads that change with the azimuth and unequal blades. For steps too long for the modes.
        RuntimeError: for a speed without a steady state, or a periodic orbit.

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
    speeds = speeds_of(speeds, scene)
    values, time = scene.tensors(inputs), instant("t", t, scene.beam.nodes)

    def diagram(scene: Scene, _: None, speeds: Tensor, values: Inputs, time: Tensor) -> Campbell:
        axis, report = Bearing.of(scene, bearing, held), progress_of(progress, len(speeds))
        done = (lambda n: None) if report is None else (lambda n: report.add(n, 0, False))
        return _computed(axis, speeds, values, time, (count, method, steps), done)

    return in_double(diagram, scene, None, speeds, values, time)


def speeds_of(speeds: Any, scene: Scene) -> Tensor:
    """(n, 1, ...) rad/s, before the scene's batch axes. Raises ValueError for other speeds, and a
    scene without a sample.
    """
    if not scene.batch_shape.numel():
        empty = f"a scene with the batch axes {tuple(scene.batch_shape)}, without a sample,"
        raise refusal(empty, "one or more", are=True)
    x = finite("speeds", as_tensor(speeds, scene.dtype, scene.device))
    if x.ndim != 1 or len(x) < 1 or bool(concrete(x[1:] <= x[:-1]).any()) or bool(x[0] < 0):
        raise refusal(f"speeds = {shown(speeds)}", "rising numbers (n,) from 0 on", are=True)
    return x.reshape(-1, *(1,) * len(scene.batch_shape))


class Spin(NamedTuple):
    """Steady spin at speeds (n, ...) rad/s, small motions about it, and what else moves the rotor
    over a turn, in words; None = nothing does. drawn: small motions about the shape as drawn, whose
    coordinates are those of the modes where something does: there blades are alike.
    """

    bearing: Bearing
    state: State
    model: SpinningModel
    unsteady: str | None
    drawn: SpinningModel


def spin_of(bearing: Bearing, speeds: Tensor, values: Inputs, time: Tensor) -> Spin:
    refuse_own_axes(bearing, *drawn(bearing, speeds[0], time, values))
    start = drawn(bearing, speeds, time, values)
    reason = unsteady(bearing, *start)
    problem, x, state = steady_spin(bearing, speeds, *start)
    reason = reason or unsteady(bearing, problem, x)
    model = as_drawn = spinning_model(bearing, problem, x, state, speeds)
    if reason is not None:
        as_drawn = spinning_model(bearing, *start, rest(bearing.model.scene), speeds)
    return Spin(bearing, state, model, reason, as_drawn)


def _modes(
    spin: Spin, values: Inputs, count: int, method: str, steps: int, done: Callable[[int], None]
) -> tuple[SpinningModes, str]:
    """`count` modes and some to spare, and by which method."""
    bearing, spinning = spin.bearing, spin.model
    pairs, periodic, growth = constant_modes(spinning, count)
    if spin.unsteady is not None:
        _refuse_unsteady(spin, method)
        state = spin.state.broadcast(spinning.speed.shape)

        def orbit(k: int, steps: int, count: int, limit: Tensor) -> Exponents:
            of = bearing, spin.drawn.at(k), state[k], values, orbit_steps(steps)
            return orbit_exponents(*of, count, limit)

        pairs = pairs._replace(right=_in_coordinates_of(spin.drawn, spinning, pairs.right))
        of = spin.drawn, pairs, growth
        return floquet_modes(*of, steps, count, done, orbit), "floquet"
    unequal = periodic > EQUAL
    if unequal and method == "multiblade":
        raise ValueError(
            "method = 'multiblade' was given for a rotor whose coefficients change with the "
            f"azimuth, by {periodic:.1g} of an eigenvalue; three or more equal blades, or "
            "method='floquet', are wanted"
        )
    if method == "floquet" or unequal:
        return floquet_modes(spinning, pairs, growth, steps, count, done), "floquet"
    return multiblade_modes(spinning, pairs, growth), "multiblade"


def _in_coordinates_of(other: SpinningModel, spinning: SpinningModel, shape: Tensor) -> Tensor:
    """Shapes (..., m, n) of one model in the coordinates of another one."""
    n = spinning.mechanical.M.shape[-1]
    to = torch.linalg.pinv(other.mechanical.moves) @ spinning.mechanical.moves
    return torch.cat(((to.to(shape.dtype) @ shape[..., :n].mT).mT, shape[..., n:]), -1)


def _refuse_unsteady(spin: Spin, method: str) -> None:
    """ValueError for a rotor without a steady state where one is wanted."""
    options = {
        "method='multiblade'": method == "multiblade",
        "held=False": spin.bearing.damping is not None,
        "several bearings": bool(spin.bearing.others),
    }
    for option, taken in options.items():
        if taken:
            raise ValueError(
                f"{spin.unsteady} was given to campbell with {option}; method='floquet', a speed "
                "that is held and one bearing are wanted, or loads that turn with the rotor or act "
                "along its axis"
            )
    if wants_gradient(spin.model.M, spin.model.D, spin.model.K):
        raise ValueError(
            f"{spin.unsteady} was given to campbell with derivatives, which periodic motions do "
            "not have; tensors without gradient are wanted"
        )


def _computed(
    bearing: Bearing,
    speeds: Tensor,
    values: Inputs,
    time: Tensor,
    options: tuple[int, str, int],
    done: Callable[[int], None],
) -> Campbell:
    """Diagram at speeds (n, ...) with its unstable ranges; options: count, method and steps."""
    count, method, steps = options
    spin = spin_of(bearing, speeds, values, time)
    modes, used = _modes(spin, values, count, method, steps, done)

    def at(speeds: Tensor) -> tuple[Motions, Tensor]:
        spin = spin_of(bearing, speeds, values, time)
        modes = _modes(spin, values, count, used, steps, lambda n: None)[0]
        return _motions(spin, modes), modes.growth > 0

    with no_derivatives():
        motions, growing, ranges = _motions(spin, modes), modes.growth > 0, None
        if growing.ndim == 1:
            tolerance = math.inf if spin.unsteady else ONSET[used]
            ranges = unstable_between(speeds.flatten(), motions, growing, at, tolerance)
    return _diagram(spin, modes, motions, count, used, steps, ranges)


def _motions(spin: Spin, modes: SpinningModes) -> Motions:
    """Of the nodes, rotations times a length."""
    spinning, model = spin.drawn.mechanical, spin.bearing.model
    shape = modes.shape.detach().flatten(-3, -2)[..., : spinning.M.shape[-1]]
    nodal = (spinning.moves.to(shape.dtype) @ shape.mT).mT.unflatten(-1, (-1, model.space.unknowns))
    nodal = (nodal / model.unit[..., None, None, :]).flatten(-2)
    return Motions(modes.eigenvalue.detach().flatten(-2), nodal)


def _diagram(
    spin: Spin,
    modes: SpinningModes,
    motions: Motions,
    count: int,
    method: str,
    steps: int,
    ranges: Ranges | None,
) -> Campbell:
    """`count` modes over the speeds, each in a column, by names."""
    bearing, spinning = spin.bearing, spin.drawn.mechanical
    space = bearing.model.space
    speeds = spinning.speed.flatten(1)[:, 0] if spinning.speed.ndim > 1 else spinning.speed
    value, shape, error, about, growth = modes
    relaxed = relaxing(spin.drawn.at(-1), value[-1, ..., 0], shape[-1, ..., 0, :])
    shape = shape.flatten(-3, -2)[..., : spinning.M.shape[-1]]
    moves = spinning.moves.to(shape.dtype)
    with no_derivatives():
        index = tracked(speeds, motions, value.shape[-1], relaxed, count)
    value, error = (x.flatten(-2).gather(-1, index) for x in (value, error))
    _refuse_few_steps(speeds, value, about[..., :count], steps)
    shape = upright(shape.gather(-2, index[..., None].expand(*index.shape, shape.shape[-1])))[0]
    below = value.imag < 0
    value = torch.where(below, value.conj(), value)
    shape = torch.where(below[..., None], shape.conj(), shape)
    with no_derivatives():
        turning = whirl(spinning, shape)
        last = (-1, *(0,) * (turning.ndim - 2))
        names = names_of(bearing, spinning.at(last), shape[last])
    nodal = space.embed((moves @ shape.mT).mT.unflatten(-1, (-1, space.unknowns)))
    return Campbell(speeds, value, nodal, turning, names, error, method, growth, ranges)


def _refuse_few_steps(speeds: Tensor, value: Tensor, near: Tensor, steps: int) -> None:
    """ValueError where steps of a turn do not tell all modes (n, ..., count); near: about these."""
    none = concrete((value.detach().abs() > abs(NONE) / 2).flatten(1).any(-1))
    if none.any():
        slow, turns = concrete(speeds)[none].min().item(), concrete(near).abs().flatten(1).amax(-1)
        turns = (turns / concrete(speeds))[none].max().item()
        wanted = max(2 * steps, math.ceil(turns * steps / fastest(torch.ones(()), steps).item()))
        modes = f"{near.shape[-1]} modes at {slow:g} rad/s"
        raise refusal(
            f"steps = {steps} of a turn for {modes}", f"steps = {wanted} or fewer modes", are=True
        )
