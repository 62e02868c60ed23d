"""Reach: static tip position as a polynomial of constant actions, its inverse, and smoothed
distances.
"""

from __future__ import annotations

import functools
import itertools
import math
import operator
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

import torchbeam as tb
from torchbeam.extend import count, shown

SOFT = 1e-3  # of the length: below it the distance in a cost is rounded off
DEGREE = 16  # of the polynomial, in either of two actions
TERMS = 500  # of the polynomial in more than two, at most
SPARE = 2  # points a term there
NEAR = 1e-9  # damping of a search that starts near its end


@dataclass(frozen=True)
class Reach:
    """Static tip position as a polynomial of the actions in [-1, 1]^a, found from one batch of
    equilibria at construction: drawing targets costs no solve.

    Of one or two actions it interpolates at Chebyshev points, DEGREE in each: for the default strip
    and reach it is within 3e-6 of the length of the equilibrium anywhere in the square. Of more it
    has all products of Chebyshev polynomials up to the total degree that TERMS allow (12 of three
    actions, 8 of four, 5 of six), by least squares over SPARE as many points, drawn with the
    density of Chebyshev points (Cohen and Migliorati 2017): within 5e-4 of the length of three
    actions, 1.5e-2 of four, 3e-2 of six (a strip bent by its tip's force and by curvatures).

    degrees       (terms, a) of the Chebyshev polynomials whose product a term is
    coefficients  (..., terms, 3) m
    """

    degrees: Tensor
    coefficients: Tensor

    @classmethod
    def of(
        cls,
        scene: tb.Scene,
        actions: int,
        inputs: Callable[[Tensor], dict[str, Tensor]],
        read: Callable[[tb.State], Tensor] | None = None,
    ) -> Reach:
        """The scene under inputs(action (..., actions)) -> name -> (..., size), as `Task.inputs`.

        read  what to interpolate instead of the tip's position: state -> (..., c)
        """
        degrees = _degrees(actions)
        if actions > 2:
            random = torch.Generator().manual_seed(0)
            angle = (
                torch.rand(SPARE * len(degrees), actions, generator=random, dtype=torch.float64)
                * torch.pi
            )
        else:
            angle = (degrees.double() + 0.5) * (torch.pi / (DEGREE + 1))
        points = torch.cos(angle).to(scene.dtype).to(scene.device)
        degrees = degrees.to(scene.device)
        state = tb.equilibrium(
            scene, inputs=inputs(points.reshape(-1, *[1] * len(scene.batch_shape), actions))
        )
        value = state.tip.position if read is None else read(state)
        return cls(
            degrees,
            torch.einsum("tp,p...c->...tc", torch.linalg.pinv(_products(points, degrees)), value),
        )

    @property
    def actions(self) -> int:
        return self.degrees.shape[-1]

    def tip(self, share: Tensor, rows: Tensor | slice = slice(None)) -> Tensor:
        """(k, 3) m, where constant actions share (k, a) hold the tips of the sub-envs `rows`.
        Raises ValueError for another number of actions.
        """
        if share.shape[-1] != self.actions:
            raise ValueError(
                f"shares of shape {tuple(share.shape)} were given; ({len(share)}, {self.actions}), "
                "of each action one, are wanted"
            )
        return self._sum(_products(share, self.degrees), rows)

    def slopes(self, share: Tensor, rows: Tensor | slice = slice(None)) -> Tensor:
        """(k, 3, a): derivatives of `tip` by the actions."""
        return torch.stack(
            [self._sum(_products(share, self.degrees, i), rows) for i in range(self.actions)], -1
        )

    def _sum(self, products: Tensor, rows: Tensor | slice) -> Tensor:
        c = self.coefficients[rows] if self.coefficients.ndim > 2 else self.coefficients
        return (products[..., None, :] @ c)[..., 0, :]


def _degrees(actions: int) -> Tensor:
    """(terms, actions), see `Reach`."""
    if actions <= 2:
        return torch.cartesian_prod(*[torch.arange(DEGREE + 1)] * actions).reshape(-1, actions)
    total = next(
        n
        for n in range(DEGREE, -1, -1)
        if math.comb(n + actions, actions) <= max(TERMS, 1 + actions)
    )
    chosen = itertools.chain.from_iterable(
        itertools.combinations_with_replacement(range(actions), n) for n in range(total + 1)
    )
    return torch.stack(
        [torch.bincount(torch.tensor(term, dtype=torch.long), minlength=actions) for term in chosen]
    )


def share_in_ball(unit: np.ndarray, axes: int) -> np.ndarray:
    """Uniform numbers of [0, 1), `uniform_numbers(axes)` each (k, ...) -> points (k, axes) uniform
    in the unit ball: [-1, 1], a disc, or one of more axes, whose direction is that of normal
    numbers.
    """
    if axes == 1:
        return 2 * unit[:, :1] - 1
    if axes == 2:
        radius, turn = unit.T
        return (np.sqrt(radius) * np.array([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)])).T
    direction = torch.special.ndtri(
        torch.from_numpy(unit[:, 1:]).clamp(min=torch.finfo(torch.float64).tiny)
    ).numpy()
    return unit[:, :1] ** (1 / axes) * direction / np.linalg.norm(direction, axis=1, keepdims=True)


def uniform_numbers(axes: int) -> int:
    """How many `share_in_ball` takes."""
    return max(2, axes + (axes > 2))


def distance(a: Tensor, b: Tensor) -> Tensor:
    """(n,) m between points (n, 3)."""
    return torch.linalg.vector_norm(a - b, dim=-1)


def rounded(d: Tensor, length: float) -> Tensor:
    """(n,): (sqrt(d^2 + s^2) - s) / (0.1 L) of distances d (n,) m: smooth at 0, about 1 at
    L / 10.
    """
    return rounded_square(d.square(), length)


def rounded_square(square: Tensor, length: float) -> Tensor:
    """The same of squared distances (...) m^2: smooth at 0 in the gaps, too."""
    soft = SOFT * length
    return ((square + soft**2).sqrt() - soft) / (0.1 * length)


def travelled(force: float, mass: float, drag: float, time: float) -> float:
    """m by which a force (N) moves a mass (kg) at most, from rest and along an axis, against a drag
    (N s/m) within a time (s): as without the drag, or as without the mass.
    """
    free = force * time**2 / (2 * mass)
    return min(free, force * time / drag) if drag else free


# actions (n, a) -> tips (n, 3) m and their derivatives (n, 3, a)
Tip = Callable[[Tensor], tuple[Tensor, Tensor]]


def nearest_action(
    tip: Tip, target: Tensor, action: Tensor, iterations: int, damping: float = 1e-3
) -> Tensor:
    """The action (n, a) within [-1, 1] whose tip is nearest the target (n, 3) m, from one near it:
    Levenberg's and Marquardt's method, each sample by itself. A step that leads away is not taken
    but damped more; actions at a bound that would go beyond it stay there. Where several actions do
    the same, it goes the short way.
    """
    eye = torch.eye(action.shape[-1]).to(action)
    damping = torch.full_like(action[:, :1], damping)
    at, J = tip(action)
    for _ in range(iterations):
        gap = target - at
        pull = (J.mT @ gap[..., None])[..., 0]
        free = ((action < 1) | (pull < 0)) & ((action > -1) | (pull > 0))
        own = J * free[:, None]
        H = own.mT @ own
        size = H.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) + torch.finfo(H.dtype).tiny
        step = torch.linalg.solve(
            H / size[..., None] + damping[..., None] * eye, pull * free / size
        )
        trial = (action + step).clamp(-1, 1)
        at_trial, J_trial = tip(trial)
        nearer = distance(at_trial, target) < distance(at, target)
        action, at = (
            torch.where(nearer[:, None], new, old) for new, old in ((trial, action), (at_trial, at))
        )
        J = torch.where(nearer[:, None, None], J_trial, J)
        damping = damping * torch.where(nearer[:, None], 0.1, 10.0)
    return action


def holding_action(
    scene: tb.Scene,
    target: Tensor,
    actions: int,
    inputs: Callable[[Tensor], dict[str, Tensor]],
    iterations: int = 12,
    guess: Tensor | None = None,
) -> Tensor:
    """The action (n, actions) whose equilibrium has its tip nearest the target (n, 3) m:
    `nearest_action` by `tb.equilibrium` of the scene under inputs(action), as `Task.inputs`.

    Of a scene with k samples n is a multiple of k, and target i belongs to sample i % k. A guess
    (n, actions) near it makes two iterations enough. Raises ValueError for another n.

    Examples:
        >>> env = envs.TipReachVectorEnv(2, elements=2, planar=True)
        >>> observation, _ = env.reset(seed=0)
        >>> action = envs.holding_action(env.scene, env.state.goal, 1, env.task.inputs)
        >>> held = tb.equilibrium(env.scene, inputs=env.task.inputs(action)).tip.position
        >>> bool((held - env.state.goal).norm(dim=-1).max() < 1e-6)  # m
        True
    """
    if not isinstance(scene, tb.Scene):
        raise ValueError(f"scene = {shown(scene)} was given; a torchbeam.Scene is wanted")
    if not callable(inputs):
        raise ValueError(f"inputs = {shown(inputs)} was given; a function of actions is wanted")
    count("actions", actions)
    count("iterations", iterations)
    for name, value in (("target", target), ("guess", guess)):
        size = 3 if name == "target" else actions
        if value is not None and not (isinstance(value, Tensor) and value.shape[1:] == (size,)):
            raise ValueError(f"{name} = {shown(value)} was given; a tensor (n, {size}) is wanted")
    samples = scene.batch_shape
    if len(target) % samples.numel():
        raise ValueError(
            f"{len(target)} targets were given for a scene of {samples.numel()} samples; as many, "
            "or a multiple of that, are wanted"
        )

    @torch.enable_grad()
    def tip(action: Tensor) -> tuple[Tensor, Tensor]:
        a = action.detach().requires_grad_()
        given = inputs(a.unflatten(0, (-1, *samples)))
        at = tb.equilibrium(scene, inputs=given).tip.position.reshape(-1, 3)
        return at.detach(), torch.stack(
            [torch.autograd.grad(at[:, i].sum(), a, retain_graph=True)[0] for i in range(3)], -2
        )

    if guess is not None:
        return nearest_action(tip, target, guess, iterations, NEAR)
    none = torch.zeros(len(target), actions, dtype=scene.dtype, device=scene.device)
    return nearest_action(tip, target, none, iterations)


def _products(x: Tensor, degrees: Tensor, slope: int | None = None) -> Tensor:
    """Terms (..., terms) at x (..., a) in [-1, 1]^a: products of T_n(x_i), n = degrees (terms, a);
    or their slopes along one axis.
    """
    whole = x.shape[-1] <= 2  # all products of one or two, see `Reach`
    T, rate = _chebyshev(x, DEGREE if whole else int(degrees.max()), slope is not None)
    factors = ((rate if i == slope else T)[..., i, :] for i in range(x.shape[-1]))
    if not whole:
        factors = (own[..., n] for own, n in zip(factors, degrees.unbind(-1), strict=True))
        return functools.reduce(operator.mul, factors)
    first, *second = (own[..., : DEGREE + 1] for own in factors)
    return (first[..., None] * second[0][..., None, :]).flatten(-2) if second else first


def _chebyshev(x: Tensor, degree: int, slopes: bool) -> tuple[Tensor, Tensor | None]:
    """T_n(x) (..., degree + 1) at least, and their slopes where these are wanted, m at a time:
    T_{m+n} = 2 T_m T_n - T_{m-n}, n = 1 ... m.
    """
    T = torch.stack((torch.ones_like(x), x), -1)
    rate = torch.stack((torch.zeros_like(x), torch.ones_like(x)), -1) if slopes else None
    for doubling in range((max(degree, 1) - 1).bit_length()):
        m = 2**doubling
        last, own, low = T[..., m:], T[..., 1:], T[..., :m].flip(-1)
        if rate is not None:
            more = rate[..., m:] * own + last * rate[..., 1:]
            rate = torch.cat((rate, 2 * more - rate[..., :m].flip(-1)), -1)
        T = torch.cat((T, 2 * last * own - low), -1)
    return T, rate
