"""Turbulence: harmonics of a given spectrum that the mean wind carries along."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.arguments import boolean, choice, count, is_integer, listed, number, whole
from ...core.leaves import leaf, option
from ...core.validation import Value, broadcast, concrete, refusal, shown
from ...math.element_shapes import gauss_points
from ...math.quaternions import cross
from .wind import WindField, direction, positive, vector

VON_KARMAN, KAIMAL = SPECTRA = ("von-karman", "kaimal")
A = 1.339  # von Karman's, of the scale
POINTS = 4  # of Gauss, in each band


def spectrum(name: str, k: Tensor, sigma: Tensor, length: Tensor) -> Tensor:
    """One-sided spectra (..., n, 3) m^3/s^2 of the components along and across the mean wind, by
    the wave number k (..., n, 3) rad/m; their integral over k > 0 is sigma^2.

        von Karman   u     2 sigma^2 L/pi (1 + (1.339 L k)^2)^(-5/6)
                     v, w  sigma^2 L/pi (1 + 8/3 (1.339 L k)^2) (1 + (1.339 L k)^2)^(-11/6)
        Kaimal       4 sigma^2 L/(2 pi) (1 + 6 L k/(2 pi))^(-5/3)

    (EASA CS 25.341(b), MIL-F-8785C; IEC 61400-1, annex.)
    """
    size = sigma.square() * length / math.pi
    if name == KAIMAL:
        return 2 * size * (1 + 3 / math.pi * length * k) ** (-5 / 3)
    q = (A * length * k).square()
    along = 2 * size * (1 + q) ** (-5 / 6)
    across = size * (1 + 8 / 3 * q) * (1 + q) ** (-11 / 6)
    return torch.cat((along[..., :1], across[..., 1:]), -1)


def energy(k: Tensor, sigma: Tensor, length: Tensor) -> Tensor:
    """Von Karman's energy by wave number, of isotropic turbulence; its integral is 3/2 sigma^2.

    E = 55/(9 pi) sigma^2 L (1.339 L k)^4 (1 + (1.339 L k)^2)^(-17/6)
    """
    q = (A * length * k).square()
    return 55 / (9 * math.pi) * sigma.square() * length * q.square() * (1 + q) ** (-17 / 6)


def _three(name: str, value: Any) -> Tensor:
    """Positive numbers of the three components, (..., 3), from such or from one number."""
    value = positive(name, value)
    value = value.expand(3) if value.ndim == 0 else value
    return value if value.shape[-1] == 3 else value[..., None].expand(*value.shape, 3)


def _seeds(name: str, value: Any) -> Any:
    seeds = (
        whole(name, value) if is_integer(value) else tuple(whole(name, x) for x in listed(value))
    )
    if seeds == ():
        raise refusal(f"{name} of no numbers", "one, or several,")
    return seeds


def _band(name: str, value: Any) -> tuple[float, float]:
    ends = listed(value)
    ends = tuple(number(name, x) for x in ends)
    if len(ends) != 2 or not 0 < ends[0] < ends[1] < math.inf:
        raise refusal(f"{name} = {shown(value)}", "two rising wave numbers, by 1/length,", are=True)
    return ends


@dataclass(frozen=True, eq=False)
class Turbulence(WindField):
    """Frozen turbulence of a given spectrum: a sum of harmonics that the mean wind carries along.

        V = mean + sum_n C_n cos(k_n . x - w_n t) + S_n sin(k_n . x - w_n t),    w_n = k_n . mean

    (Taylor 1938; harmonics: Shinozuka and Jan 1972; isotropic: Kraichnan 1970.)

    Args:
        mean: (..., 3) m/s
        sigma: m/s, standard deviation: (...) of all components, or (..., 3) along and across mean
        length: m, integral scale L, likewise
        up: (..., 3) of any length: the last component is across `mean` in the plane of both
        spectrum: "von-karman" or "kaimal", see `spectrum`
        isotropic: False: waves run along `mean`, the same across it, as CS 25.341(b) has it. True:
            waves run in all directions, without divergence, of von Karman's energy spectrum with
            sigma and L of the first component. Neighbours are coherent as in the real field
        harmonics: n. Each costs a sine and a cosine at each node. With 32 of them a beam's
            step takes 1.5 to 2.2 times as long as without air, with Wagner's strips alone 1.3 times
        band: least and largest wave number, in units of 1/L of the first component. Harmonics lie
            evenly in the logarithm between. The default leaves out 5 % of the variance
        seed: of phases and directions; several make a batch

    Each harmonic has the energy of its band, so the variance is that of the spectrum within `band`,
    whatever the seed. It is differentiable in mean, sigma and length.

    Raises:
        ValueError: for numbers that are not positive, a mean wind along `up`, or an isotropic
            Kaimal spectrum.

    Examples:
        >>> wind = tb.Turbulence((10.0, 0, 0), sigma=1.5, length=100.0, seed=3)
        >>> wind.velocity(torch.zeros(1, 3), torch.tensor(0.0)).shape
        torch.Size([1, 3])
    """

    mean: Value = leaf(1, check=vector)
    sigma: Value = leaf(1, check=_three)
    length: Value = leaf(1, check=_three)
    up: Value = leaf(1, default=(0.0, 0.0, 1.0), kw_only=True, check=direction)
    spectrum: str = option(lambda n, v: choice(n, v, SPECTRA), default=VON_KARMAN, kw_only=True)
    isotropic: bool = option(boolean, default=False, kw_only=True)
    harmonics: int = option(count, default=32, kw_only=True)
    band: tuple[float, float] = option(_band, default=(0.03, 300.0), kw_only=True)
    seed: int | Sequence[int] = option(_seeds, default=0, kw_only=True)
    _waves: Tensor = leaf(2, init=False)
    _rates: Tensor = leaf(1, init=False)
    _cosine: Tensor = leaf(2, init=False)
    _sine: Tensor = leaf(2, init=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.isotropic and self.spectrum == KAIMAL:
            raise refusal("Turbulence, isotropic, of a Kaimal spectrum", "von Karman's")
        several = [] if is_integer(self.seed) else [(len(self.seed),)]
        held = (self.mean, self.sigma, self.length, self.up)
        broadcast("Turbulence's numbers", *(x.shape[:-1] for x in held), *several)
        e = direction("Turbulence's mean", self.mean)
        side = cross(self.up, e)
        size = side.square().sum(-1, keepdim=True).sqrt()
        if concrete(size < 1e-6).any():
            raise refusal("Turbulence with a mean wind along up", "one across it")
        axes = torch.stack(torch.broadcast_tensors(e, side / size, cross(e, side / size)), -2)
        waves, cosine, sine = self._isotropic() if self.isotropic else self._along(axes)
        rates = (waves * self.mean[..., None, :]).sum(-1)
        vars(self).update(_waves=waves, _rates=rates, _cosine=cosine, _sine=sine)

    def _bands(self, energies: Callable[[Tensor], Tensor]) -> tuple[Tensor, Tensor]:
        """Middles (..., n) rad/m of the bands, and the integrals of energies(k) over them."""
        L = self.length[..., :1]
        ends = torch.linspace(*map(math.log, self.band), self.harmonics + 1, dtype=L.dtype)
        middle, half = (ends[1:] + ends[:-1]) / 2, (ends[1:] - ends[:-1]) / 2
        total = 0.0
        for place, weight in zip(*(x.tolist() for x in gauss_points(POINTS)), strict=True):
            k = torch.exp(middle + place * half) / L
            total = total + weight * (half * k)[..., None] * energies(k[..., None])
        return torch.exp(middle) / L, total

    def _drawn(self, *shape: int) -> Tensor:
        """Numbers (seeds, *shape) of the normal distribution; of one seed without that axis."""
        seeds = (self.seed,) if is_integer(self.seed) else self.seed
        like = self.length
        with torch._C._DisableFuncTorch():  # torch.vmap refuses what is drawn, whatever the seed
            numbers = [
                torch.randn(
                    shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed)
                )
                for seed in seeds
            ]
        numbers = torch.stack(numbers).to(like)
        return numbers[0] if is_integer(self.seed) else numbers

    def _along(self, axes: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Waves along the first of the axes (..., 3, 3), as rows; equal across it."""
        sigma, L = self.sigma[..., None, :], self.length[..., None, :]
        k, squares = self._bands(lambda k: spectrum(self.spectrum, k, sigma, L))
        pair = self._drawn(2, self.harmonics, 3)
        phases = torch.atan2(*pair.unbind(-3))
        size = (2 * squares).sqrt()
        waves = k[..., None] * axes[..., None, 0, :]
        return waves, size * phases.cos() @ axes, size * phases.sin() @ axes

    def _isotropic(self) -> tuple[Tensor, Tensor, Tensor]:
        """Waves in all directions, velocities across them."""
        sigma, L = self.sigma[..., None, :1], self.length[..., None, :1]
        k, squares = self._bands(lambda k: energy(k, sigma, L))
        n, *ways = (
            x / x.square().sum(-1, keepdim=True).sqrt()
            for x in self._drawn(3, self.harmonics, 3).unbind(-3)
        )
        across = (cross(n, x) for x in ways)
        cosine, sine = (
            (2 * squares).sqrt() * x / x.square().sum(-1, keepdim=True).sqrt() for x in across
        )
        return k[..., None] * n, cosine, sine

    def __str__(self) -> str:
        return f"Turbulence of {self.harmonics} harmonics"

    def velocity(self, position: Tensor, t: Tensor) -> Tensor:
        phase = position.to(self._waves) @ self._waves.mT - (self._rates * t)[..., None, :]
        return self.mean[..., None, :] + (phase.cos() @ self._cosine + phase.sin() @ self._sine)
