"""Smooth histories of recorded motions: splines whose smoothness is chosen by the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import count, number
from ...core.leaves import FunctionOfTime, leaf, option
from ...core.validation import Value, as_tensor, common_dtype, increasing, positive, refusal
from ...core.warning import warn
from ...math import quaternions
from ...math.bsplines import basis, penalty
from ...math.extremum import golden_section
from .histories import _interval

DEGREE, ROUGH = 5, 3  # of the pieces; of the derivative whose squares are held small
PIECES = 400  # at most
FEWEST = 8  # readings
QUARTER = math.cos(math.pi / 4)  # of half the angle of a quarter of a turn
TRIED = 60  # weights of smoothness, before the best is found to SAME of its logarithm
UNCERTAIN = 0.5  # share of accelerations that are not known, above which a sentence says so


def _sigma(name: str, value: Any) -> Any:
    if value is None:
        return None
    return positive(name, torch.tensor(number(name, value), dtype=torch.float64)).item()


def _order(order: int) -> int:
    if count("order", order, 0) > 2:
        raise refusal(f"order = {order}", "0, 1 or 2")
    return order


@dataclass(frozen=True)
class SmoothHistory(FunctionOfTime):
    """A smooth function of t from a motion that was recorded with noise.

    Use it as the displacement of a `Support` or `RootMotion`, or as the drive of a joint. A turn is
    a `SmoothRotation`.

    Args:
        t: (n,) s, strictly increasing, at any intervals
        values: (..., n, k); readings with a NaN are left out
        sigma: standard deviation of the noise of a reading; None = found from the record

    It has pieces of degree 5 with continuous acceleration, jerk and rate of jerk. They minimise the
    squared residuals over the noise, plus a weight times the integral of the squared jerk. The
    weight maximises the restricted likelihood (Wood 2011, JRSS B 73, 3), and is the same for all
    columns. Before and after the record the value is constant. It is differentiable in t, and in
    `values` at a fixed weight.

    `deviation(order)` gives the uncertainty of the motion and its rates. `share` is the uncertainty
    of accelerations, and so of the force on a mass that moves so, as a share; a UserWarning names
    it above 0.5. `noise` is the deviation of a reading, given or found.

    Raises:
        ValueError: for fewer than 8 readings, or times that do not increase.

    Examples:
        >>> t = torch.linspace(0, 1, 101)  # s
        >>> noise = 1e-5 * torch.randn(101, 3, generator=torch.Generator().manual_seed(0))
        >>> measured = 0.01 * torch.sin(10 * t)[:, None] * torch.tensor([0.0, 0.0, 1.0]) + noise
        >>> moved = tb.SmoothHistory(t, measured)
        >>> moved.share < 0.1  # accelerations are known to a tenth
        True
        >>> shaken = tb.Scene(beam, root=tb.RootMotion(displacement=moved))
    """

    t: Tensor = leaf(1)
    values: Tensor = leaf(2)
    sigma: float | None = option(_sigma, default=None)
    noise: float = field(default=0.0, init=False)
    _breaks: Tensor = leaf(1, init=False)
    _pieces: Tensor = leaf(3, init=False)
    _root: Tensor = leaf(2, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        dtype, device = common_dtype(self.t, self.values)
        t, values = (as_tensor(v, dtype, device).clone() for v in (self.t, self.values))
        increasing("a SmoothHistory's t", t)
        if values.ndim < 2 or values.shape[-2] != len(t):
            raise ValueError(
                f"a SmoothHistory's values of shape {tuple(values.shape)} were given for t of "
                f"shape {tuple(t.shape)}; (..., n, k) are wanted"
            )
        seen = values.isfinite().movedim(-2, 0).flatten(1).all(-1)
        if seen.sum() < FEWEST:
            raise refusal(
                f"a SmoothHistory of {int(seen.sum())} readings", f"{FEWEST} at least", are=True
            )
        # fewer numbers than readings, of which each piece has some
        at, n = t[seen].detach(), int(seen.sum())
        ends = (
            torch.linspace(0, n - 1, min((n - 4) // 2, PIECES) + 1, dtype=torch.float64)
            .round()
            .long()
        )
        breaks = at[ends]
        columns = values.movedim(-2, 0)[seen].flatten(1)
        (coefficients, root), noise = _fitted(at, columns, breaks, self.sigma)
        pieces = torch.stack(
            [basis(breaks, breaks[:-1], DEGREE, j) @ coefficients / math.factorial(j)
             for j in range(DEGREE + 1)]
        )  # fmt: skip
        pieces = pieces.reshape(DEGREE + 1, len(ends) - 1, *values.shape[:-2], values.shape[-1])
        pieces = pieces.movedim((1, 0), (-3, -2))  # (..., pieces, degree + 1, k)
        for name, value in (("t", t), ("values", values), ("noise", noise), ("_breaks", breaks),
                            ("_pieces", pieces), ("_root", root)):  # fmt: skip
            object.__setattr__(self, name, value)
        if self.share > UNCERTAIN:
            warn(
                f"a SmoothHistory whose accelerations are known to {100 * self.share:.0f} % only "
                f"was made: a noise of {noise:.2g} reaches the forces; a record with less noise, "
                "or of more readings, is wanted, or one of the accelerations (Accelerogram)",
                UserWarning,
            )

    def __call__(self, t: Tensor) -> Tensor:
        """(..., k) at the instant t (0-dim)."""
        k = _interval(self._breaks, t)
        start, end = self._breaks.index_select(0, k)[0], self._breaks[-1]
        piece = self._pieces.index_select(-3, k)[..., 0, :, :]
        # by `clamp`, with whole rates at the record's ends: minimum and maximum halve them there
        h = t.to(self._breaks).clamp(self._breaks[0], end) - start
        value = piece[..., DEGREE, :]
        for j in range(DEGREE - 1, -1, -1):
            value = value * h + piece[..., j, :]
        return value

    def rate(self, order: int, t: Value | None = None) -> Tensor:
        """(..., m, k) values (order 0), velocities (1), accelerations (2) at t (m,)."""
        times = self.t if t is None else as_tensor(t, self.t.dtype, self.t.device)
        place = torch.searchsorted(self._breaks, times.detach(), right=True) - 1
        k = place.clamp(0, len(self._breaks) - 2)
        h, piece = (times - self._breaks[k])[:, None], self._pieces.index_select(-3, k)
        value = torch.zeros_like(piece[..., 0, :])
        for j in range(DEGREE, _order(order) - 1, -1):
            value = value * h + math.perm(j, order) * piece[..., j, :]
        return value

    def deviation(self, order: int = 0, t: Value | None = None) -> Tensor:
        """(m,) standard deviation of what `rate` says, of each column: Bayesian, as smooth as was
        found (Wahba 1983, JRSS B 45, 133).
        """
        times = self.t if t is None else as_tensor(t, self.t.dtype, self.t.device)
        rows = basis(self._breaks, times.detach(), DEGREE, _order(order))
        return self.noise * (rows @ self._root).square().sum(-1).sqrt()

    @property
    def share(self) -> float:
        """Median deviation of accelerations over their RMS; the record's ends are known worse."""
        accelerations = self.rate(2).detach()
        size = accelerations.square().mean(-2).sum(-1).mean().sqrt().item()
        spread = accelerations.shape[-1] ** 0.5 * self.deviation(2).median().item()
        return spread / size if size else math.inf if spread else 0.0

    def __repr__(self) -> str:
        span = (self.t[-1] - self.t[0]).item()
        return (
            f"SmoothHistory({len(self.t)} readings over {span:.4g} s; noise {self.noise:.2g}, of "
            f"the history {self.deviation().square().mean().sqrt().item():.2g}; accelerations "
            f"known to {100 * self.share:.2g} %, and so are forces on what moves with it)"
        )


@dataclass(frozen=True)
class SmoothRotation(SmoothHistory):
    """A smooth function of t from rotations that were recorded with noise; it returns rotation
    vectors (3,) rad.

    Use it as the `turn` of a `Support` or the `rotation` of a `RootMotion`.

    Args:
        t: (n,) s, strictly increasing
        values: (n, 3, 3), quaternions (n, 4) w first, of any sign, or rotation vectors (n, 3). Of
            poses (n, 4, 4) take `poses[:, :3, :3]`, with a `SmoothHistory` of `poses[:, :3, 3]`
        sigma: rad, of a component of the small rotation that is the noise; None = found from the
            record
        reference: one rotation of the same form from which they are counted, R = exp(phi)
            reference: the node's axes in the beam; None = no rotation

    It is a `SmoothHistory` of unit quaternions, so any number of turns about any axis is smooth. Of
    the vectors of one rotation it returns the shortest. `rate(1)`, `rate(2)` are angular velocity
    and acceleration, frame a. Deviations are rad, rad/s and rad/s^2.

    Raises:
        ValueError: as `SmoothHistory`; for neighbours that are a quarter of a turn apart, or more.

    Examples:
        >>> t = torch.linspace(0, 1, 101)
        >>> angle = 20.0 * t  # rad, more than three turns about z
        >>> q = torch.stack((torch.cos(angle / 2), 0 * t, 0 * t, torch.sin(angle / 2)), -1)
        >>> turned = tb.SmoothRotation(t, q)
        >>> turned.rate(1)[50]  # rad/s
        tensor([ 0.,  0., 20.])
    """

    reference: Any = option(lambda name, value: value, default=None, kw_only=True)

    def __post_init__(self) -> None:
        q = _quaternions("rotations", self.values, 2)
        if self.reference is not None:
            origin = _quaternions("reference", self.reference, 1).to(q)
            q = quaternions.multiply(q, quaternions.conjugate(origin).expand_as(q))
        same = (q[1:] * q[:-1]).sum(-1)
        if (far := (same.abs() < QUARTER).nonzero()).numel():
            k = int(far[0])
            raise ValueError(
                f"rotations of which the readings {k} and {k + 1} are a quarter of a turn apart, "
                "or more, were given; more readings are wanted"
            )
        sign = torch.cat((torch.ones_like(same[:1]), same.sign())).cumprod(0)
        object.__setattr__(self, "values", q * sign[:, None])
        sigma = _sigma("sigma", self.sigma)
        object.__setattr__(self, "sigma", None if sigma is None else sigma / 2)
        super().__post_init__()

    def __call__(self, t: Tensor) -> Tensor:
        """(3,) rad at the instant t (0-dim)."""
        return quaternions.logarithm(quaternions.normalize(super().__call__(t)))

    def rate(self, order: int, t: Value | None = None) -> Tensor:
        """(m, 3) rotation vectors, angular velocities or accelerations at t (m,), None: its own."""
        q = quaternions.normalize(super().rate(0, t))
        if not _order(order):
            return quaternions.logarithm(q)
        return 2 * quaternions.multiply(super().rate(order, t), quaternions.conjugate(q))[:, 1:]

    def deviation(self, order: int = 0, t: Value | None = None) -> Tensor:
        return 2 * super().deviation(order, t)


def _quaternions(name: str, rotations: Value, axes: int) -> Tensor:
    """(4,) or (n, 4) of rotations in any form."""
    R = as_tensor(rotations, *common_dtype(rotations))
    if R.ndim == axes + 1 and R.shape[-2:] == (3, 3):
        return quaternions.from_matrix(R)
    if R.ndim == axes and R.shape[-1] == 4:
        return quaternions.normalize(R)
    if R.ndim == axes and R.shape[-1] == 3:
        return quaternions.exponential(R)
    raise ValueError(
        f"{name} of shape {tuple(R.shape)} were given; matrices, quaternions or rotation vectors "
        "are wanted"
    )


def _fitted(
    t: Tensor, y: Tensor, breaks: Tensor, sigma: float | None
) -> tuple[tuple[Tensor, Tensor], float]:
    """Coefficients (K, columns) and a root (K, K) of their covariance over the noise's variance,
    and the deviation of that; of readings y (n, columns).
    """
    B, P = basis(breaks, t, DEGREE), penalty(breaks, DEGREE, ROUGH)
    n, columns = y.shape
    G = B.mT @ B
    little = 1e-14 * G.trace() / P.trace()
    lower = torch.linalg.cholesky(G + little * P)
    half = torch.linalg.solve_triangular(lower, P, upper=False)
    rough, axes = torch.linalg.eigh(torch.linalg.solve_triangular(lower, half.mT, upper=False))
    rough[:ROUGH] = 0
    axes = torch.linalg.solve_triangular(lower.mT, axes, upper=True)  # (K, K)
    middle = y.mean(0)
    rows = B @ axes
    z, off = rows.mT.to(y) @ (y - middle), (y - middle).detach().to(rows)

    def left(weight: float) -> float:
        c = z.detach().to(rows) / (1 + (weight - little) * rough)[:, None]
        apart = (off - rows @ c).square().sum()
        return (apart + weight * (rough[:, None] * c.square()).sum()).item()

    def unlikely(log: float) -> float:
        weight, freedom = math.exp(log), columns * (n - ROUGH)
        size = left(weight)
        size = size / sigma**2 if sigma else freedom * math.log(max(size, 1e-300))
        log_det = torch.log1p((weight - little) * rough).sum().item()
        return size + columns * (log_det - (len(rough) - ROUGH) * log)

    ends = 1e-3 / rough[-1].item(), 1e3 / rough[ROUGH].item()
    ends = (math.log(max(end, 2 * little)) for end in ends)
    tried = torch.linspace(*ends, TRIED, dtype=torch.float64).tolist()
    best = min(range(TRIED), key=lambda k: unlikely(tried[k]))
    log = golden_section(unlikely, tried[max(best - 1, 0)], tried[min(best + 1, TRIED - 1)])
    weight = math.exp(log)
    noise = sigma or math.sqrt(left(weight) / (columns * (n - ROUGH)))
    shrunk = 1 / (1 + (weight - little) * rough)
    # splines of one order take the mean as it is: all basis functions sum to one
    coefficients = (axes * shrunk).to(y) @ z + middle
    return (coefficients, axes * shrunk.sqrt()), noise
