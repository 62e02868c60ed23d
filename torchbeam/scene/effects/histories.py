"""Functions of time from samples: load histories and accelerograms."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.leaves import FunctionOfTime, leaf
from ...core.validation import Value, as_tensor, common_dtype, finite, increasing


@dataclass(frozen=True)
class History(FunctionOfTime):
    """A load's value from samples: straight lines between them, constant before the first and after
    the last.

    Args:
        t: (n,) s, strictly increasing
        values: (..., n, 3)

    Its rate, which the block rate form needs, is the slope of the line. Differentiable in t and in
    both tensors.

    Examples:
        >>> t = torch.linspace(0, 1, 11)
        >>> record = tb.History(
        ...     t, torch.stack((0 * t, 0 * t, torch.sin(3 * t)), -1)
        ... )  # N, linear between samples
        >>> shaken = tb.Scene(beam, [tb.TipLoad(force=record)])
        >>> record(torch.tensor(0.05))
        tensor([0.0000, 0.0000, 0.1478])
    """

    t: Tensor = leaf(1)
    values: Tensor = leaf(2)

    def __post_init__(self) -> None:
        t, values = _sampled("a History's", self.t, self.values)
        vars(self).update(t=t, values=values)

    def __call__(self, t: Tensor) -> Tensor:
        """(..., 3) at the instant t (0-dim)."""
        return between_samples(self.t, self.values, t)


@dataclass(frozen=True)
class Accelerogram(FunctionOfTime):
    """A displacement (..., 3) m from a sampled acceleration: the record of a shaker or an
    earthquake.

    Use it as `RootMotion(displacement=...)`.

    Args:
        t: (n,) s, strictly increasing
        acceleration: (..., n, 3) m/s^2, frame a: straight lines between the samples

    Displacement and velocity are zero at the first sample and before; after the last the velocity
    stays. Between samples the displacement is an exact cubic, u = u_k + v_k h + a_k h^2/2 +
    (a_{k+1} - a_k) h^3/(6 dt). Differentiable in t and in both tensors. A record with an offset
    drifts as its square: subtract the offset first.

    Examples:
        >>> t = torch.linspace(0, 1, 201)  # s, a record of 200 Hz
        >>> quake = tb.Accelerogram(
        ...     t, 3.0 * torch.sin(20 * t)[:, None] * torch.tensor([0.0, 0.0, 1.0])
        ... )
        >>> shaken = tb.Scene(beam, root=tb.RootMotion(displacement=quake))
        >>> tb.simulate(shaken, t[:11], step=0.005).nodes[-1, 0]  # m, where the ground is
        tensor([0.0000, 0.0000, 0.0012])
    """

    t: Tensor = leaf(1)
    acceleration: Tensor = leaf(2)
    _velocity: Tensor = leaf(2, init=False)
    _displacement: Tensor = leaf(2, init=False)

    def __post_init__(self) -> None:
        # velocities are of these
        t, a = (x.clone() for x in _sampled("an Accelerogram's", self.t, self.acceleration))
        dt = t.diff()[:, None]
        before, after = a[..., :-1, :], a[..., 1:, :]
        v = pad((dt * (before + after) / 2).cumsum(-2), (0, 0, 1, 0))
        u = pad((dt * v[..., :-1, :] + dt**2 * (2 * before + after) / 6).cumsum(-2), (0, 0, 1, 0))
        vars(self).update(t=t, acceleration=a, _velocity=v, _displacement=u)

    def __call__(self, t: Tensor) -> Tensor:
        """(..., 3) m at the instant t (0-dim)."""
        k = _interval(self.t, t)
        start, end = self.t.index_select(0, k)[0], self.t.index_select(0, k + 1)[0]
        a, b = (self.acceleration.index_select(-2, i)[..., 0, :] for i in (k, k + 1))
        v, v_end = (self._velocity.index_select(-2, i)[..., 0, :] for i in (k, k + 1))
        u = self._displacement.index_select(-2, k)[..., 0, :]
        t = t.to(self.t)
        h = (t - start).clamp(torch.zeros_like(start), end - start)
        inside = u + v * h + a * h**2 / 2 + (b - a) * h**3 / (6 * (end - start))
        return inside + torch.where(t > end, t - end, torch.zeros_like(end)) * v_end


def _sampled(whose: str, t: Value, values: Value) -> tuple[Tensor, Tensor]:
    """t (n,) and values (..., n, 3), checked."""
    dtype, device = common_dtype(t, values)
    t, values = (as_tensor(v, dtype, device) for v in (t, values))
    increasing(f"{whose} t", t)
    if values.ndim < 2 or values.shape[-2:] != (len(t), 3):
        raise ValueError(
            f"{whose} values of shape {tuple(values.shape)} were given; (..., {len(t)}, 3) are "
            "wanted"
        )
    return t, finite(f"{whose} values", values)


def between_samples(samples: Tensor, values: Tensor, t: Tensor, axis: int = -2) -> Tensor:
    """Values at t (0-dim) of those at samples (n,), along `axis`: straight lines between them,
    constant beyond.
    """
    k = _interval(samples, t)
    a, b = samples.index_select(0, k)[0], samples.index_select(0, k + 1)[0]
    before, after = (values.index_select(axis, i).select(axis, 0) for i in (k, k + 1))
    return before + ((t.to(samples) - a) / (b - a)).clamp(0, 1) * (after - before)


def _interval(samples: Tensor, t: Tensor) -> Tensor:
    """Number (1,), a tensor, of the interval that t lies in, the first or last outside."""
    k = (torch.searchsorted(samples.detach(), t.detach().to(samples), right=True) - 1).clamp(
        0, len(samples) - 2
    )
    return k.reshape(1)
