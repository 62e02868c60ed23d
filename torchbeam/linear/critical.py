"""Critical loads: where an equilibrium loses its stability, by divergence (buckling) or by flutter.

The eigenvalues of M a'' + D a' + K a = 0 are followed along a load path. Without damping
s = lambda^2: a real s that rises through zero is divergence, two that meet and turn complex are
flutter, (Im s)^2 then being straight in the load where it begins. With damping the largest real
part rises through zero. The derivatives are those of the condition that holds there, with v and w
the right and left null vectors of Q = K + lambda D + lambda^2 M:

    w^T Q(factor, parameters) v = 0,
    flutter with damping: Re(w^T Q v / (w^T (D + 2 lambda M) v)) = 0

(where two eigenvalues meet w^T M v = 0, so that the change of s itself drops out; Seyranian and
Mailybaev 2003, ch. 4 to 6).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import boolean, choice, number
from ..core.arguments import count as check_count
from ..core.arguments import tolerance as check_tolerance
from ..core.derivatives import no_derivatives
from ..core.functions_of_time import OtherPrecision
from ..core.leaves import wants_gradient
from ..core.memory import check_memory
from ..core.summary import kind, lines, span
from ..core.validation import concrete
from ..core.warning import warn
from ..engine.chain.coverage import ENGINES
from ..math.eigen_derivatives import upright
from ..math.first_derivative import Once
from ..scene.in_double import SINGLE, narrowed
from ..scene.scene import Scene
from .load_path import DIVERGENCE, FLUTTER, STABLE, Factored, LoadPath
from .system_matrices import moves

KINDS = ("stable", "divergence", "flutter", "lost")
NUMBERS = 1000  # of a state and its matrices, at least
PARTS = 9  # of the bracket in a round
ROUNDING = 4  # of a bracket, in last places


@dataclass(frozen=True)
class Critical:
    """The first loss of stability along a load path; leading axes are batch axes.

    Args:
        factor: (...) of the load; NaN if it stays stable. Differentiable, except for LOST
        kind: (...) int: DIVERGENCE = 1; FLUTTER = 2; STABLE = 0, up to the highest factor; LOST =
            3, stable up to the end of the path (a limit point, see `path`)
        frequency: (...) rad/s of the motion that begins; 0 for a divergence
        shape: (..., N+1, 6) of that motion (real part), displacement and spin, frame a; its largest
            entry is 1
        factors: (P, ...) the load path
        eigenvalue: (P, ..., count) complex, 1/s, along the path, the slowest

    Examples:
        >>> column = lambda P: tb.Scene(
        ...     beam, [tb.TipLoad(force=-P[..., None] * torch.tensor([1.0, 0, 0]))]
        ... )
        >>> critical = tb.critical_load(column, highest=10.0)
        >>> critical.factor  # N, of a clamped column
        tensor(3.4945)
    """

    factor: Tensor
    kind: Tensor
    frequency: Tensor
    shape: Tensor
    factors: Tensor
    eigenvalue: Tensor

    def __repr__(self) -> str:
        kinds = concrete(self.kind).flatten()
        counts = [
            f"{name} in {number}"
            for k, name in enumerate(KINDS)
            if (number := int((kinds == k).sum()))
        ]
        known = self.factor[torch.isfinite(concrete(self.factor))]
        return lines(
            "Critical",
            f"factor {span(known)}",
            ", ".join(counts),
            f"looked at {len(self.factors)} factors",
            kind(self.factor.shape, self.factor),
        )

    @property
    def divergence(self) -> Tensor:
        return self.kind == DIVERGENCE

    @property
    def flutter(self) -> Tensor:
        return self.kind == FLUTTER


def critical_load(
    scene: Factored | Scene,
    highest: float,
    *,
    lowest: float = 0.0,
    points: int = 17,
    count: int = 6,
    tolerance: float = 1e-6,
    t: float = 0.0,
    lumped: bool = False,
    engine: str = "auto",
    inputs: dict[str, Any] | None = None,
) -> Critical:
    """The smallest load factor at which the equilibrium loses its stability: buckling or flutter.

    Args:
        scene: a Scene with inputs, whose values the factor multiplies. Or a function factor ->
            Scene, whose factor (points, ...) broadcasts with the batch axes of the scene's tensors
        lowest, highest: range of factors to search
        points: number of factors tried first, evenly spaced. An instability that ends before the
            next factor is overlooked
        count: number of eigenvalues computed, the slowest; faster flutter is overlooked
        tolerance: relative size of the final bracket, some roundings at least. Interpolation within
            it leaves an error of about its square
        engine: of the equilibria, see `equilibrium`
        inputs: by name, (..., size): at factor 1

    - **Flutter.** If the scene has damping, even of the value 0, or turns, flutter is a real part
      that grows. Otherwise it is two frequencies that meet (with half as many unknowns). For
      damping of the value 0 the frequency at flutter is one of two that are about to meet, off by
      4e-4.
    - **Path.** Each equilibrium starts from the one before, except where supports turn. Past a
      point of buckling the path stays on its branch. At a limit point it ends or leaps; `path`
      finds such points more quickly.
    - **Cost.** O(N) a factor along a single beam of more than 96 unknowns without damping.
      Otherwise, and where the few eigenvalues of a long beam do not converge, it is dense, O(N^3).
    - **Precision.** Scenes in single precision are solved in double and the answer is rounded, as
      in `modes`.

    Raises:
        ValueError: for a scene that the nodal form does not take, an empty range, free rigid
            motions, or a scene that is unstable at `lowest`.

    Examples:
        >>> column = lambda P: tb.Scene(
        ...     beam, [tb.TipLoad(force=-P[..., None] * torch.tensor([1.0, 0, 0]))]
        ... )
        >>> P = tb.critical_load(column, highest=10.0).factor
        >>> EI = 69e9 * 0.03 * 0.002**3 / 12
        >>> P / (torch.pi**2 * EI / 4)  # of Euler's
        tensor(1.0263)
    """
    highest, lowest, t = number("highest", highest), number("lowest", lowest), number("t", t)
    check_tolerance("tolerance", tolerance)
    if not highest > lowest:
        raise ValueError(
            f"factors from {lowest:g} to {highest:g} were given; a highest above the lowest is "
            "wanted"
        )
    boolean("lumped", lumped)
    choice("engine", engine, ENGINES)
    given = scene, inputs, t, lumped, check_count("count", count), engine
    path = LoadPath(*given, wide=True)
    try:
        critical = _critical_load(path, highest, lowest, points, tolerance)
    except OtherPrecision:
        if not path.single:
            raise
        critical = _critical_load(LoadPath(*given, wide=False), highest, lowest, points, tolerance)
        warn(SINGLE, UserWarning)
    return narrowed(critical) if path.single else critical


def _critical_load(
    path: LoadPath, highest: float, lowest: float, points: int, tolerance: float
) -> Critical:
    """`critical_load` along a path."""
    with no_derivatives():
        shape = path.batch_shape(lowest)
        states = check_count("points", points, least=2) * shape.numel()
        check_memory(f"{points} factors", NUMBERS * 8 * states, "fewer points are wanted")
        even = torch.linspace(lowest, highest, points, dtype=torch.float64, device=path.device)
        factors = even.reshape(-1, *[1] * len(shape)).expand(len(even), *shape)
        states = path.branch(factors)
        coarse = path.spectrum(factors, states)
        doubtful = coarse.kind[0] != STABLE
        if (doubtful | coarse.neutral[0]).any() and (loose := path.loose(lowest)):
            raise ValueError(
                f"a beam of which nothing holds {loose} was given; supports that hold it, or a "
                "plane without that motion, are wanted"
            )
        if doubtful.any():
            raise ValueError(
                f"a beam that is unstable or without equilibrium at the lowest factor, {lowest:g}, "
                "was given; a stable one is wanted there"
            )
        low, high, kind = _first(factors, coarse.kind)
        path.go_on(factors, states, low)
        # brackets of neighbouring numbers have no inside
        tolerance = max(tolerance, ROUNDING * torch.finfo(low.dtype).eps)
        inner = torch.linspace(0, 1, PARTS + 1, dtype=even.dtype, device=even.device)
        inner = inner.reshape(-1, *[1] * len(shape))
        while (high - low > tolerance * torch.maximum(high.abs(), low.abs())).any():
            there = low + (high - low) * inner
            states = path.equilibrium(there[1:-1], path.start)
            between = path.spectrum(there[1:-1], states).kind
            low, high, kind = _first(
                there, torch.cat((torch.zeros_like(kind)[None], between, kind[None]))
            )
            path.go_on(there[1:-1], states, low)
        factor, leading = path.crossing(low, high, kind)
    critical = (kind == DIVERGENCE) | (kind == FLUTTER)
    leading = torch.where(kind == FLUTTER, leading, 0)
    model, condition, v, basis = path.condition(factor, leading, kind)
    if wants_gradient(condition(factor)):
        with no_derivatives():
            nudge = 1e-4 * torch.maximum(
                factor.abs(), torch.full_like(factor, 1e-2 * (highest - lowest))
            )
            slope = (condition(factor + nudge) - condition(factor - nudge)) / (2 * nudge)
        here = Once.apply(condition(factor))
        factor = factor - torch.where(critical, (here - here.detach()) / slope, 0.0)
    frequency = leading.imag.abs() if path.damped else leading.real.neg().clamp(min=0).sqrt()
    slow = coarse.eigenvalue if path.damped else _root(coarse.eigenvalue)
    nan = torch.full_like(frequency, torch.nan)
    shape = upright(v[..., : model.constraints.count - model.multipliers.held_count])[0].real
    return Critical(
        torch.where(kind == STABLE, nan, factor),
        kind,
        torch.where(critical, frequency, nan),
        moves(model, shape, basis),
        factors,
        slow,
    )


def _first(factors: Tensor, kind: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The bracket of the first unstable factor (P, ...), and its kind; without one the last."""
    lost = kind != STABLE
    any_lost = lost.any(0)
    at = torch.where(any_lost, lost.to(torch.int8).argmax(0), len(kind) - 1)[None]
    high = factors.gather(0, at)[0]
    low = torch.where(any_lost, factors.gather(0, (at - 1).clamp(min=0))[0], high)
    return low, high, kind.gather(0, at)[0]


def _root(square: Tensor) -> Tensor:
    root = square.sqrt()
    return torch.where(root.imag < 0, -root, root)
