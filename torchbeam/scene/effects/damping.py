"""Damping proportional to stiffness (stress by strain rate) and to mass (force by velocity)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from ...core.arguments import boolean
from ...core.leaves import leaf, option
from ...core.validation import Value, as_tensor, common_dtype, finite, refusal
from ...math.block_matrices import of_blocks
from ...math.quaternions import skew
from .effect import Effect
from .load_point import ROTATION, SPIN, VELOCITY, LoadEffect, LoadPoint, Wrench
from .values import Inputs


@dataclass(frozen=True)
class Damping(Effect):
    """Stiffness-proportional damping: [F; M] = S^-1 (strain + tau * strain rate).

    Args:
        tau: (...) s, one value; or six in a Python sequence, one for each strain [gamma1..3,
            kappa1..3]. The damping matrix of six is D^1/2 S^-1 D^1/2 with D = diag(tau), which is
            symmetric and never adds energy.
        six: whether tau (..., 6) has a value for each strain. Default: true for a sequence. A
            tensor or an array is one value with batch axes, six samples as well as five.
        on: name of a beam of a structure; None = all. Each beam may have its own damping

    Raises:
        ValueError: for a negative tau, and for a sequence of another length.

    Examples:
        >>> damped = tb.Scene(beam, [tb.Damping(tau=0.01)])  # s
        >>> tb.modes(damped, count=1).damping_ratio  # tau omega/2 of the first mode
        tensor([0.0511])
    """

    tau: Value = leaf(lambda damping: int(damping.six), nonnegative=True, name="tau")
    six: bool | None = option(boolean, default=None, name="six")
    on: str | None = field(default=None, kw_only=True)

    by_place = False
    kind = "strain"

    def __post_init__(self) -> None:
        if self.six is None:
            object.__setattr__(self, "six", isinstance(self.tau, (list, tuple)))
        super().__post_init__()
        if self.six and self.tau.shape[-1:] != (6,):
            raise refusal(
                f"tau of shape {tuple(self.tau.shape)}",
                "one value (a batch is a tensor), or one for each of six strains,",
            )


@dataclass(frozen=True)
class MassDamping(LoadEffect):
    """Mass-proportional damping, against the absolute motion of all masses.

    Force and moment are -alpha R Mass R^T [velocity; spin], per length of the beam and of each
    `PointMass` at its node. A rigid motion is damped too: this models the air around a beam, not
    the beam.

    Args:
        alpha: (...) 1/s; a free vibration decays as exp(-alpha t / 2), whatever its frequency
        on: name of a beam or a body of a structure; None = all

    Raises:
        ValueError: for a negative alpha.

    Examples:
        >>> aired = tb.Scene(beam, [tb.MassDamping(alpha=2.0)])  # 1/s
        >>> tb.modes(aired, count=1).damping_ratio  # alpha/(2 omega) of the first mode
        tensor([0.1003])
    """

    alpha: Value = leaf(0, nonnegative=True, name="alpha")
    on: str | None = field(default=None, kw_only=True)

    by_place = False
    by_mass = True
    conservative = True
    depends = frozenset({ROTATION, VELOCITY, SPIN})

    def wrench(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> Wrench:
        # rows R^T v and R^T w
        motion = torch.stack(torch.broadcast_tensors(point.velocity, point.spin), -2) @ point.R
        momenta = (point.mass @ motion.flatten(-2)[..., None])[..., 0]
        momenta = momenta.unflatten(-1, (2, 3)) @ point.R.mT
        return tuple((-self.alpha[..., None, None, None] * momenta).unbind(-2))

    def tangent(self, point: LoadPoint, t: Tensor, inputs: Inputs) -> dict[str, Tensor]:
        """By the motion: -alpha R Mass R^T; by spin: R and R^T turn."""
        M = self._mass(point)
        force, moment = self.wrench(point, t, inputs)
        turned = M @ torch.cat(torch.broadcast_tensors(skew(point.velocity), skew(point.spin)), -2)
        turned = turned - torch.cat((skew(force), skew(moment)), -2)
        return {ROTATION: turned, VELOCITY: M[..., :3], SPIN: M[..., 3:]}

    def _mass(self, point: LoadPoint) -> Tensor:
        """-alpha times the mass per length in frame a, (..., sites, 6, 6)."""
        zero = torch.zeros_like(point.R)
        both = of_blocks(point.R, zero, zero, point.R)
        return -self.alpha[..., None, None, None] * (both @ point.mass @ both.mT)


def rayleigh(
    frequency: Sequence[Value] | Tensor, ratio: Sequence[Value] | Tensor
) -> tuple[MassDamping, Damping]:
    """Rayleigh damping with given damping ratios of two modes: a pair of `MassDamping` and
    `Damping`.

    The ratio is alpha/(2 w) + tau w/2 (Rayleigh 1877). For more than two modes it is fitted in the
    least squares of the ratios.

    Args:
        frequency: two or more w, rad/s, (...) each; or (..., n), as in `modes(scene).frequency`
        ratio: of each mode, likewise; 1 = critical. A mode between two has less damping than both,
            modes beyond them have more

    A beam can also have a tau for each kind of strain. `Damping` of six values damps stretching,
    shear, torsion and bending about y and z by tau w/2 each, with w the frequency of the mode. A
    damping matrix made of the modes themselves is not offered. It would tie every node to every
    other, and hold only for small motions about one shape.

    Raises:
        ValueError: for fewer than two different frequencies, or if the fit has a negative
            coefficient: the ratios are then too different for the frequencies.

    Examples:
        >>> first, second = tb.modes(tb.Scene(beam), count=2).frequency  # rad/s
        >>> effects = tb.rayleigh((first, second), (0.01, 0.02))  # damping ratios of both
        >>> tb.modes(tb.Scene(beam, effects), count=2).damping_ratio
        tensor([0.0102, 0.0202])
    """
    dtype, device = common_dtype(frequency, ratio)
    w, z = (
        finite(name, as_tensor(v, dtype, device))
        for name, v in (("frequency", frequency), ("ratio", ratio))
    )
    if w.ndim == 0 or w.shape[-1] < 2 or z.ndim == 0 or z.shape[-1] != w.shape[-1]:
        raise ValueError(
            f"rayleigh with frequencies of shape {tuple(w.shape)} and ratios of shape "
            f"{tuple(z.shape)} was given; (..., n) of both is wanted, n = 2 or more"
        )
    if not (w > 0).all() or (w == w[..., :1]).all(-1).any():
        raise ValueError(
            "rayleigh with equal frequencies, or with one that is not positive, was given; "
            "positive ones that differ are wanted"
        )
    scale = w.mean(-1, keepdim=True)
    shares = torch.stack((scale / (2 * w), w / (2 * scale)), -1)
    alpha, tau = (torch.linalg.pinv(shares) @ z.to(w)[..., None])[..., 0].unbind(-1)
    if (tau < 0).any() or (alpha < 0).any():
        raise ValueError(
            "rayleigh with ratios that take a negative coefficient was given; ratios nearer to "
            "each other are wanted"
        )
    return MassDamping(alpha * scale[..., 0]), Damping(tau / scale[..., 0], six=False)


def geometric_means(tau: Tensor) -> Tensor:
    """(tau_i tau_j)^1/2 (..., 6, 6); the diagonal is tau, so that a zero has a derivative."""
    some = tau > 0
    root = torch.where(
        some, torch.where(some, tau, torch.ones_like(tau)).sqrt(), torch.zeros_like(tau)
    )
    diagonal = torch.eye(tau.shape[-1], dtype=torch.bool, device=tau.device)
    return torch.where(diagonal, tau[..., None], root[..., :, None] * root[..., None, :])
