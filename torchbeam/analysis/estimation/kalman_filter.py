"""Kalman filter: the state and the unknowns of a structure, from readings as they come."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.arguments import batch as sizes_of
from ...core.arguments import boolean, count, function, instance, number, step_size
from ...core.one_thread import few_on_one_thread
from ...core.validation import as_tensor, axis_last, positive, refusal
from ...dynamics.method import Method
from ...dynamics.stepper import Stepper
from ...linear.chart import Place
from ...linear.linear_model import Linear
from ...linear.state_space import linearize
from ...math.shapes import broadcast_shapes, stacked
from ...math.square_root import Later, root_of
from ...scene.scene import Scene
from ...state.state import State
from .columns import Columns
from .filtered import Filtered, Predicted
from .instruments import Instruments, still
from .interval import Interval, Moved, Standing
from .limits import Limits
from .modal_start import modal_root
from .products import Products
from .unknowns import Unknowns, mean_scene, rows_of, with_priors
from .weighting import Weighting

STANDS = 0.25  # deviation of a parameter, up to which the structure stays that of before


def _numbers(known: Any) -> int:
    """Of the square root of what is known, before an interval or at its end."""
    return getattr(getattr(known, "before", known), "factor", torch.empty(0)).numel()


class KalmanFilter:
    """Extended Kalman filter in square-root form for the motion z of a structure. Parameters,
    offsets of readings and forces are further unknowns. Each sample of a batch has its own filter.

    Args:
        scene: a `Scene`; or a function of parameters (name -> (..., *shape)) that returns a Scene,
            always of the same mesh and reference shape
        sensors: a sensor or several. Or a function (scene, inputs) -> sensors, if they depend on
            the scene; the inputs are those of the interval that ends with the reading
        rate: whether readings are the mean rate of the sensor's value over the interval: a bool, or
            a bool for each sensor. The rate of `NodeVelocity` is an accelerometer's, less gravity
        dt: s, the interval between readings
        noise: deviation of the readings, a number or (m,); white noise
        process: name of an input of the scene -> deviation of an unknown force that adds to it, of
            the input's size or a number. The force is independent in each interval. A pair
            (deviation, time) is an estimated force that changes within that time in s
            (Ornstein-Uhlenbeck process); with math.inf s it is constant
        parameters: name -> (mean, deviation), or a `Parameter` with a prior
        walk: name of a parameter -> deviation of its coordinate's change in a second
        shaking: m, deviation of the slowest mode's amplitude by other forces within a second. They
            are white, with the same energy in each mode of z
        bias: deviation of a constant offset of the readings, a number or (m,); 0 = none
        delay: number of intervals by which readings are late
        drive: (parameters, u (..., k)) -> name -> (..., size): inputs that act for commands `u`,
            with unknown actuators; None = `u` itself
        steps: of the structure in an interval
        model: linear model with the coordinates z. A reduced model has amplitudes of modes; the
            rest follows. None = `linearize` about equilibrium, by mean parameters, without inputs
        method: as in `Stepper`, except methods with a memory beyond z
        gate: probability, e.g. 0.999999. A reading is left out if it is beyond the interval in
            which it is expected with this probability. After five in a row the estimate is wrong,
            not the sensor: further ones count as if they were at the interval's end (Fang, Haile
            and Wang 2019). None = none is left out
        loss: "huber" or "student", in place of squares: large residuals (outliers) have less weight
        bounds: name of an offset or a force -> (least, largest). Those of a parameter are its own,
            `tb.Parameter(bounds=)`, and ten first deviations. They hold for the estimate; its
            deviation ignores them
        second_order: whether the predicted mean and covariance include products of the deviations
            of z and of the parameters. The derivatives are taken at `model`'s own state

    Derivatives of the motion and of the readings are exact: an interval is stepped with as many
    samples as z and the readings have numbers. Readings may depend on the force in their interval.
    A reading that is not finite is missing. Raises ValueError for arguments that do not fit, and
    for joints with a hysteresis.

    Examples:
        >>> wind = tb.LineLoad(force=tb.Input("wind", 3))
        >>> f = tb.KalmanFilter(
        ...     tb.Scene(beam, [wind, tb.Damping(0.01)]),
        ...     tb.sensors.TipPosition(),
        ...     dt=0.02,
        ...     noise=1e-3,
        ...     process={"wind": (0.1, 0.5)},
        ... )
        >>> z = f(f.start(), (1.0, 0.0, 0.002))
        >>> z.state.tip.position.shape, z.unknown["wind[2]"].shape
        (torch.Size([3]), torch.Size([]))
    """

    def __init__(
        self,
        scene: Scene | Callable[[dict[str, Tensor]], Scene],
        sensors: Any,
        *,
        dt: float,
        noise: Any,
        rate: bool | Sequence[bool] = False,
        process: Mapping[str, Any] | None = None,
        parameters: Mapping[str, Any] | None = None,
        walk: Mapping[str, Any] | None = None,
        shaking: float = 0.0,
        bias: Any = 0.0,
        delay: int = 0,
        drive: Callable[[dict[str, Tensor], Tensor], dict[str, Tensor]] | None = None,
        steps: int = 1,
        model: Linear | None = None,
        method: str = "midpoint",
        second_order: bool = True,
        gate: float | None = None,
        loss: str | None = None,
        bounds: Mapping[str, Any] | None = None,
    ) -> None:
        self.dt, self.delay = step_size("dt", dt), count("delay", delay, least=0)
        steps, known = count("steps", steps), with_priors(parameters)
        mean = mean_scene(scene, known)
        self.like = like = mean.beam.nodes.new_zeros(())
        instruments = Instruments.of(sensors, noise, rate, mean, like)
        self.unknowns = Unknowns.of(
            known, walk, bias, instruments.labels, process, mean.inputs, self.dt, like
        )
        self.weighting = Weighting.of(loss, gate, instruments.noise)
        stepper = Stepper(mean, self.dt / steps, method)
        if type(stepper.method).begin is not Method.begin:
            raise ValueError(
                f"method = {method!r} was given; a midpoint method is wanted, whose states "
                "remember nothing beside z"
            )
        if mean.joint_memory:
            raise ValueError(
                "a scene whose joints have a hysteresis was given, which remember more than z; one "
                "without is wanted"
            )
        if model is None:
            model = linearize(mean, inputs=still(mean))
        model = instance("model", model, Linear)
        if drive is not None:
            drive = function("drive", drive, "parameters", "u")
        self.interval = Interval(mean, scene, instruments, stepper, model, steps, method, drive)
        self.read, self.moves = instruments.count, model.reads.shape[-2]
        self.columns = Columns(self.unknowns, self.moves, self.read, self.delay)
        self._standing: Standing | None = None  # the last; no result depends on it
        n = self.moves
        self.limits = Limits.of(self.unknowns, n, bounds)
        positive("shaking", like.new_tensor(number("shaking", shaking)), zero=True)
        root = modal_root(model, shaking * self.dt**0.5, n // 2)[n // 2 :] if shaking else None
        # of motion and parameters, where these are of the scene
        self.products = None
        if boolean("second_order", second_order) and self.unknowns.of_model:
            self.products = Products.of(self.interval, self.unknowns)
        # (s, size): what comes on top of x at the begin of an interval
        self.shaken = (
            like.new_zeros(0, self.size) if root is None else pad(root, (0, self.size - n))
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_standing": None}

    @property
    def size(self) -> int:
        """Of x: z, the unknowns, and readings on their way."""
        return self.columns.size

    def start(
        self,
        batch: int | Sequence[int] = (),
        *,
        state: State | None = None,
        amplitude: float = 0.0,
        modes: int = 4,
        covariance: Any = None,
    ) -> Filtered:
        """Estimate before the first reading.

        Args:
            batch: samples
            state: of the structure; None = the state at z = 0
            amplitude: m, deviation of the slowest mode, at the node that it moves most. Up to
                `modes` modes have the same mean energy
            covariance: (..., n, n) of z, in place of `amplitude`

        Raises ValueError for an invalid covariance, and for both `amplitude` and `covariance`.
        """
        state = self.interval.model.state if state is None else instance("state", state, State)
        batch = (batch,) if isinstance(batch, int) else batch
        shape = broadcast_shapes(sizes_of("batch", batch), state.batch_shape)
        if number("amplitude", amplitude) and covariance is not None:
            raise ValueError("amplitude was given beside covariance; one of the two is wanted")
        n, k, late = self.moves, len(self.unknowns.names), self.delay * self.read
        factor = self.like.new_zeros(*shape, self.size, self.size)
        if amplitude:
            root = modal_root(self.interval.model, amplitude, min(count("modes", modes), n // 2))
            factor[..., : root.shape[-2], :n] = root
        if covariance is not None:
            given = axis_last("covariance", as_tensor(covariance, self.like.dtype), n)
            factor[..., :n, :n] = root_of("covariance", given)
        factor[..., n : n + k, n : n + k] = torch.diag(self.unknowns.deviation)
        state = state.broadcast(shape).detach()
        z = self.interval.model.departure(state)
        x = torch.cat((z, self.unknowns.start.expand(*shape, -1), z.new_zeros(*shape, late)), -1)
        if late:  # readings before the first are those of the start
            rest, scene = self.interval.instruments.at_rest, self.interval.scene
            y, by = self.interval.slope_of(lambda now: rest(scene, now), state)
            x[..., n + k :] = torch.cat([y] * self.delay, -1)
            factor[..., n + k :] = torch.cat([factor[..., :n] @ by.mT] * self.delay, -1)
        zero, none = z.new_zeros(shape), z.new_zeros(*shape, self.read)
        lately = z.new_zeros(*shape, 3)
        return Filtered(self, state, x, factor, zero, zero, none, zero, lately, none)

    def __call__(self, before: Filtered, y: Any = None, u: Any = None) -> Filtered:
        """What is known an interval later.

        Args:
            y: (..., m) the readings at its end, NaN where one is missing; None = none
            u: the inputs held over it, (..., inputs) side by side in the scene's order, or by name;
                those that are not given are 0; with `drive` what that takes
        """
        return self.update(self.predict(before, u), y)

    @few_on_one_thread(lambda self, before, *_, **__: _numbers(before))
    def predict(self, before: Filtered, u: Any = None) -> Predicted:
        """What is expected an interval later: `update` takes it, with the readings.

        It is most of the work of a call, and can be done during the interval. u: as in a call.
        """
        before = instance("before", before, Filtered).of(self.size)
        inputs, about = self.interval.side_by_side(u), self._about(before)
        after, expected, x, columns = self._moved(before.state, before.x, inputs, about)
        more, rows = after.more[..., : self.moves], None
        if self.products is not None:
            n, p = self.moves, self.unknowns.of_model
            parts = self.products(before.factor[..., :n], before.factor[..., n : n + p])
            mean, rows = map(self.columns.placed, parts)
            expected, x = expected + mean[..., : self.read], x + mean[..., self.read :]
            more = more + mean[..., self.read : self.read + self.moves]
        return Predicted(before, inputs, about, after, expected, x, columns, more, rows)

    @few_on_one_thread(lambda self, predicted, *_, **__: _numbers(predicted))
    def update(self, predicted: Predicted, y: Any = None) -> Filtered:
        """What is known once it is read: y (..., m), NaN where one is missing; None = none."""
        before, _, about, after, expected, x, columns, more, rows = instance(
            "predicted", predicted, Predicted
        )
        before.of(self.size)
        if after is None:
            raise refusal("a prediction of a MovingHorizon", "one of this filter's predict")
        by_x, sources = self._sources(before.factor, columns, rows)
        known, error = sources[..., : self.read], self._readings(y, expected) - expected
        error, missed = self.weighting.clipped(known, error, before.missed)
        now = self._learned(replace(before, missed=missed), by_x, sources, error)
        now = replace(now, state=after.state, x=x, about=about)
        return self._changed(now, now.learnt[1].change, more, after.places[1])

    def run(self, start: Filtered, readings: Any, u: Any = None) -> list[Filtered]:
        """Estimates after each of the readings (K, ..., m). Commands u are (K, ..., inputs), or by
        name.
        """
        y = as_tensor(readings, self.like.dtype, self.like.device)
        found = [start]
        y = axis_last("readings", y, self.read)
        named = isinstance(u, Mapping)
        each = {n: rows_of(n, v, y) for n, v in u.items()} if named else rows_of("u", u, y)
        for k, now in enumerate(y):
            given = {n: v[k] for n, v in each.items()} if named else each[k]
            found.append(self(found[-1], now, given))
        return found[1:]

    def smooth(self, start: Filtered, found: Sequence[Filtered]) -> list[Filtered]:
        """Estimates from all readings: of the start, then of each instant of a `run` from it
        (Bryson and Frazier 1963). There is one more than in `found`.
        """
        smooth, m = [found[-1]], self.read
        x = found[-1].x
        later = Later(torch.zeros_like(x), x.new_zeros(*x.shape[:-1], 0, self.size))
        for before, after in zip(reversed([start, *found[:-1]]), reversed(found), strict=True):
            by_x, given = after.learnt
            later = later.before(given, by_x[..., :m].mT, by_x[..., m:].mT)
            change, root = later.given(before.factor)
            smooth.append(self._changed(replace(before, factor=root), change))
        return smooth[::-1]

    def _changed(
        self,
        found: Filtered,
        change: Tensor,
        more: Tensor | float = 0.0,
        place: Place | None = None,
    ) -> Filtered:
        """With x (..., size) changed so, within limits, and the state with z, by `more` (..., n)
        beside, by which x is beyond that state; place: of the state, None = not known.
        """
        change = change + self.limits.change(found.x + change, found.factor)
        by = change[..., : self.moves] + more
        return replace(
            found, x=found.x + change, state=self.interval.changed(found.state, by, place)
        )

    def _about(self, before: Filtered) -> Tensor:
        """(..., p): coordinates of parameters at which each sample's structure stands: where it
        stood, as long as none has moved by more than a share of its deviation.
        """
        own = slice(self.moves, self.moves + self.unknowns.of_model)
        now, about = before.x[..., own], before.about
        if about is None:
            return now
        moved = (now - about).abs() > STANDS * before.factor[..., own].norm(dim=-2)
        return torch.where(moved.any(-1, keepdim=True), now, about) if moved.any() else about

    def _moved(
        self, state: State, x: Tensor, u: Tensor, about: Tensor
    ) -> tuple[Moved, Tensor, Tensor, Tensor]:
        """An interval later, of what is as x (..., size) and under inputs u (..., inputs) says: the
        motion of a structure of parameters of coordinates `about`; by those of x what is read of it
        (..., m), x, and `Columns` of both.
        """
        own, n, k = self.unknowns, self.moves, self.moves + len(self.unknowns.names)
        beside, underway = x[..., n:k], x[..., k:]
        coordinates = beside[..., : own.of_model]
        given, standing = u if self.interval.drive is None else torch.zeros_like(own.white), None
        if own.of_model:
            lead = broadcast_shapes(state.batch_shape, x.shape[:-1], u.shape[:-1])
            standing = self._standing = self.interval.standing(own, about, lead, self._standing)
        after = self.interval.move(state, own, coordinates, own.acting(beside, given), u, standing)
        z, read = after.z + after.more[..., :n], after.readings + after.more[..., n:]
        lead = read.shape[:-1]
        if self.delay:
            arriving, read = read, underway[..., -self.read :]
            underway = torch.cat((arriving, underway[..., : -self.read]), -1)
        parts = [part.expand(*lead, -1) for part in (z, beside * own.stays, underway)]
        read = own.with_offsets(read, beside).expand(*lead, -1)
        return after, read, torch.cat(parts, -1), self.columns.after(after)

    def _readings(self, y: Any, like: Tensor) -> Tensor:
        """y (..., m), NaN where one is missing; None = all."""
        y = (torch.nan,) * self.read if y is None else y
        y = axis_last("y", as_tensor(y, like.dtype, like.device), self.read)
        return y.where(torch.isfinite(y), torch.nan)

    def _sources(
        self, factor: Tensor, columns: Tensor, rows: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Readings and x' by x, and by independent sources of unit variance, where x has this
        factor; rows (..., s, m + size): further sources of both, None = none.
        """
        by_x, by_fresh = columns.split((self.size, columns.shape[-2] - self.size), -2)
        roots = torch.cat((factor, self.shaken.expand(*factor.shape[:-2], -1, -1)), -2)
        return by_x, stacked(roots @ by_x, by_fresh, *(() if rows is None else (rows,)))

    def _learned(
        self,
        before: Filtered,
        by_x: Tensor,
        sources: Tensor,
        error: Tensor,
        weight: Tensor | None = None,
    ) -> Filtered:
        """With what readings of errors (..., m) say of `_sources`, with how many were `missed` now;
        weight (..., m): None = as the errors say.
        """
        known, missed = sources[..., : self.read], before.missed
        if weight is None:
            weight = self.weighting(known, error, missed)
        by_x, learnt = self.weighting.conditioned(by_x, sources, error, weight)
        read = (weight > 0).sum(-1).to(error)
        beyond = self.weighting.beyond(known, error, missed, weight)
        density = self.weighting.log_density(learnt, weight)
        now = replace(
            before,
            factor=learnt.root[..., : self.size, :],
            nis=(learnt.unit**2).sum(-1),
            readings=read,
            weight=weight,
            log_likelihood=before.log_likelihood + density + beyond.log_density,
            learnt=(by_x, learnt),
        )
        return now.judged(beyond)
