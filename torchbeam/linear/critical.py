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

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.arguments import boolean, number
from ..core.arguments import count as check_count
from ..core.arguments import function as check_function
from ..core.arguments import tolerance as check_tolerance
from ..core.derivatives import no_derivatives
from ..core.leaves import wants_gradient
from ..core.memory import check_memory
from ..core.summary import kind, lines, span
from ..core.validation import concrete, unmapped
from ..math.block_chain import BlockChain
from ..math.dense import solve_unchecked
from ..math.first_derivative import Once
from ..math.quadratic_eigen import plus, rounding, slow_first, slow_values, upright
from ..math.shapes import broadcast_shapes
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..scene.scene import Scene
from ..state.state import State
from ..statics.equilibrium import equilibrium
from ..statics.mechanism import unheld
from .system_matrices import in_basis, moves, of_chain, of_nodes

STABLE, DIVERGENCE, FLUTTER, LOST = range(4)
KINDS = ("stable", "divergence", "flutter", "lost")
NUMBERS = 1000  # of a state and its matrices, at least
PARTS = 9  # of the bracket in a round
COMPLEX = 1e-5  # |Im s| / |s| from which on a pair has met; it counts 1e-10 of the load
GROWING = 1e-6  # Re(lambda) / |lambda| from which on a damped motion grows
Factored = Callable[[Tensor], Scene]
Matrices = tuple[Any, Any, Any]  # M, D, K: tensors, or chains


class _Spectrum(NamedTuple):
    """At a load: eigenvalue (..., count), the slowest: s, or lambda where damped. kind (...);
    neutral (...) whether there is a motion that nothing but rounding resists. For each kind of loss
    the measure (...) that is straight where it begins, and the eigenvalue that decides.
    """

    eigenvalue: Tensor
    kind: Tensor
    neutral: Tensor
    divergence: Tensor
    flutter: Tensor
    leading: Tensor


@dataclass(frozen=True)
class Critical:
    """The first loss of stability along a load path; leading axes are batch axes.

    factor       (...) of the load; NaN where it stays stable. Differentiable, but for LOST
    kind         (...) int: DIVERGENCE = 1, FLUTTER = 2; STABLE = 0 up to the highest factor;
                 LOST = 3: stable up to where the
                 way up ends (a limit point, see `path`)
    frequency    (...) rad/s of the motion that begins: 0 of a divergence
    shape        (..., N+1, 6) of that motion (real part), displacement and spin, frame a; its
                 largest entry is 1
    factors      (P, ...) the load path that was looked at;  eigenvalue (P, ..., count) complex,
                 1/s: along it, the slowest
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
    inputs: dict[str, Any] | None = None,
) -> Critical:
    """The smallest load factor between `lowest` and `highest` at which the equilibrium loses its
    stability.

    scene      factor -> Scene, for a factor (points, ...) that broadcasts with the batch axes of
               the scene's own tensors; or a Scene with inputs, whose values are multiplied by the
               factor
    points     factors looked at first, evenly; a loss that is made good before the next one is
               overlooked
    count      eigenvalues looked at, the slowest; they hold flutter of no faster ones
    tolerance  relative, of the bracket; what is left after interpolation in it is about its square
    inputs     by name, (..., size): at factor 1

    Where the scene has damping, even of the value 0, or turns, flutter is a real part that grows,
    else two frequencies that meet (and half as many unknowns); for a value of 0 the frequency at
    flutter is one of two that are about to, off by 4e-4.

    The path is that of `equilibrium`: past a point of buckling it keeps to the branch it is on. At
    a limit point it ends, or leaps; `path` finds those more quickly. O(N) a factor along one beam
    of more than 96 unknowns without damping; dense, O(N^3), of anything else, and where the few
    eigenvalues of a long one do not converge.

    Raises ValueError for what the nodal form does not take, a range that is empty, rigid motions
    that nothing holds, or a scene that is unstable at `lowest`.
    """
    highest, lowest, t = number("highest", highest), number("lowest", lowest), number("t", t)
    check_tolerance("tolerance", tolerance)
    if not highest > lowest:
        raise ValueError(
            f"factors from {lowest:g} to {highest:g} were given; a highest above the lowest is "
            "wanted"
        )
    path = _Path(scene, inputs, t, boolean("lumped", lumped), check_count("count", count))
    with no_derivatives():
        shape = path.batch_shape(lowest)
        states = check_count("points", points, least=2) * shape.numel()
        check_memory(f"{points} factors", NUMBERS * 8 * states, "fewer points are wanted")
        even = torch.linspace(lowest, highest, points, device=path.device)
        factors = even.reshape(-1, *[1] * len(shape)).expand(len(even), *shape)
        coarse = path.spectrum(factors)
        unmapped("critical_load", coarse.kind)
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
        inner = torch.linspace(0, 1, PARTS + 1, device=path.device).reshape(-1, *[1] * len(shape))
        while (high - low > tolerance * torch.maximum(high.abs(), low.abs())).any():
            there = low + (high - low) * inner
            between = path.spectrum(there[1:-1]).kind
            low, high, kind = _first(
                there, torch.cat((torch.zeros_like(kind)[None], between, kind[None]))
            )
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
    shape = upright(v[..., : model.constraints.count - model.joints.held_count])[0].real
    return Critical(
        torch.where(kind == STABLE, nan, factor),
        kind,
        torch.where(critical, frequency, nan),
        moves(model, shape, basis),
        factors,
        slow,
    )


class _Path:
    """The scene at any load factor: equilibrium, matrices, eigenvalues."""

    def __init__(
        self,
        scene: Factored | Scene,
        inputs: dict[str, Any] | None,
        t: float,
        lumped: bool,
        count: int,
    ) -> None:
        if not isinstance(scene, Scene) and not callable(scene):
            raise ValueError(
                f"a scene of type {type(scene).__name__} was given; a Scene, or a function of the "
                "load factor that returns one, is wanted"
            )
        if isinstance(scene, Scene) and not scene.inputs:
            raise ValueError(
                "a scene without inputs was given; one with inputs to multiply, or a function of "
                "the load factor that returns a scene, is wanted"
            )
        if not isinstance(scene, Scene):
            check_function("scene", scene, "factor")
        self.of, self.inputs, self.t, self.lumped, self.count = scene, inputs, t, lumped, count
        self.damped, self.device = False, scene.device if isinstance(scene, Scene) else None

    def scene(self, factor: Tensor) -> tuple[Scene, dict[str, Tensor]]:
        if isinstance(self.of, Scene):
            given = self.of.tensors(self.inputs)
            return self.of, {
                name: factor[..., None].to(value) * value for name, value in given.items()
            }
        scene = self.of(factor)
        if not isinstance(scene, Scene):
            raise ValueError(
                f"a function that returns {type(scene).__name__} was given; one that returns a "
                "Scene is wanted"
            )
        return scene, scene.tensors(self.inputs)

    def batch_shape(self, lowest: float) -> torch.Size:
        scene, inputs = self.scene(torch.tensor(float(lowest), device=self.device))
        self.device = scene.device
        return broadcast_shapes(scene.batch_shape, *(v.shape[:-1] for v in inputs.values()))

    def loose(self, factor: float) -> str:
        """Rigid motions that nothing holds, in words."""
        scene, inputs = self.scene(torch.tensor(factor, device=self.device))
        t = torch.as_tensor(self.t, dtype=scene.dtype, device=scene.device)
        return unheld(discretise(scene), t, inputs, (0,) * len(self.batch_shape(factor)))[1]

    def matrices(
        self, factor: Tensor, near: Tensor | None = None
    ) -> tuple[Model, State, Matrices, Tensor | None]:
        """M, D, K: of a long chain as such, else dense, with their basis, near another one."""
        scene, inputs = self.scene(factor)
        with warnings.catch_warnings():
            # of unstable branches: they are what is looked for
            warnings.simplefilter("ignore", RuntimeWarning)
            state = equilibrium(scene, t=self.t, throw=False, inputs=inputs)
        model = discretise(scene, self.lumped)
        t = torch.as_tensor(self.t, dtype=scene.dtype, device=scene.device)
        M, D, K, lagging = of_nodes(model, state, t, inputs)
        undamped = D is None and lagging is None
        chains = of_chain(model, M, K, self.count) if undamped else None
        if chains is not None:
            return model, state, (chains[0], None, chains[1]), None
        return model, state, *in_basis(model, M, D, K, lagging, near)

    def spectrum(self, factor: Tensor) -> _Spectrum:
        model, state, (M, D, K), _ = self.matrices(factor)
        self.damped, lags = D is not None, model.internal_states > 0
        value = slow_values(M, D, K, self.count)
        slow = slow_first(value, self.count, lags)
        if lags:  # and the slowest that decay, which are the next to diverge
            slow = torch.cat((slow, slow_first(value, self.count, False)), -1)
        value = value.gather(-1, slow)
        real, size = value.real, value.abs()
        turning = value.imag > COMPLEX * size
        # s is real, whatever rounding makes of it where K is next to singular
        if model.conservative and not self.damped:
            turning = torch.zeros_like(turning)
        if self.damped:
            flutter = torch.where(turning, real, -torch.inf)
            grows = real > GROWING * size
        else:
            flutter = torch.where(turning, value.imag**2, 0.0)
            grows = (real > 0) | turning
        divergence = torch.where(turning, -torch.inf, real).amax(-1)
        flutter, which = flutter.max(-1)
        kind = torch.where(
            (grows & ~turning).any(-1),
            DIVERGENCE,
            torch.where((grows & turning).any(-1), FLUTTER, STABLE),
        )
        kind = torch.where(state.status == 0, kind, LOST).expand(factor.shape)
        neutral = (
            ((size.square() if self.damped else size) <= rounding(M, K)[..., None])
            .any(-1)
            .expand(factor.shape)
        )
        leading = value.gather(-1, which[..., None])[..., 0]
        return _Spectrum(value[..., : self.count], kind, neutral, divergence, flutter, leading)

    def crossing(self, low: Tensor, high: Tensor, kind: Tensor) -> tuple[Tensor, Tensor]:
        """Zero of the measure, by a straight line through its values at the two ends, undamped
        flutter's (a square above, nothing below) beyond the upper end; and the eigenvalue there.
        """
        width = high - low
        below, above, beyond = (self.spectrum(x) for x in (low, high, high + width))
        a, b = (below, above) if self.damped else (above, beyond)
        start = low if self.damped else high
        share = torch.where(
            kind == FLUTTER,
            -a.flutter / (b.flutter - a.flutter),
            -below.divergence / (above.divergence - below.divergence),
        )
        share = torch.where(torch.isfinite(share), share, 0.0)
        factor = torch.where(kind == FLUTTER, start, low) + share * width
        factor = torch.minimum(torch.maximum(factor, low), high)
        leading = a.leading + share * (b.leading - a.leading)
        return factor, leading if self.damped else leading.real.to(leading.dtype)

    def condition(
        self, factor: Tensor, leading: Tensor, kind: Tensor
    ) -> tuple[Model, Callable[[Tensor], Tensor], Tensor, Tensor | None]:
        """Critical condition, zero at the critical factor, as a function of the factor and of what
        the scene holds; the shape, and the basis that it is in.
        """

        def parts(
            factor: Tensor, near: Tensor | None = None
        ) -> tuple[Model, Any, Any, Tensor | None]:
            model, _, (M, D, K), basis = self.matrices(factor, near)
            if D is None:
                return model, plus(K, leading, M), M, basis
            return (model, plus(plus(K, leading, D), leading**2, M), plus(D, 2 * leading, M), basis)

        with no_derivatives():
            model, Q, slope, basis = parts(factor)
            v, w = _null(Q)
            scale = _form(w, slope, v) if self.damped else torch.ones_like(leading)
            scale = torch.where(kind == FLUTTER, scale, _form(w, Q.abs(), v).abs().to(v.dtype))
        shape = v if isinstance(Q, Tensor) else v[..., model.constraints.unknowns.grouped]
        return (
            model,
            lambda factor: (_form(w, parts(factor, basis)[1], v) / scale).real,
            shape,
            basis,
        )


def _first(factors: Tensor, kind: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The bracket of the first factor (P, ...) that is not stable, and its kind; where all are, the
    last one twice.
    """
    lost = kind != STABLE
    any_lost = lost.any(0)
    at = torch.where(any_lost, lost.to(torch.int8).argmax(0), len(kind) - 1)[None]
    high = factors.gather(0, at)[0]
    low = torch.where(any_lost, factors.gather(0, (at - 1).clamp(min=0))[0], high)
    return low, high, kind.gather(0, at)[0]


def _null(Q: Tensor | BlockChain) -> tuple[Tensor, Tensor]:
    """Right and left null vectors (..., n), by inverse iteration; the left one starts from the
    right one, so that of several (equal bending in two planes) the two belong together.
    """
    n, like = (Q.shape[-1], Q) if isinstance(Q, Tensor) else (Q.size, Q.diagonal)
    v = torch.cos(1.7 * torch.arange(n, dtype=like.real.dtype, device=like.device) + 0.3)
    v, vectors = v.to(like.dtype), []
    for matrix in (Q, Q.mT):
        solve = _solver(matrix)
        for _ in range(3):
            v = solve(v)
            v = v / v.gather(-1, v.abs().argmax(-1, keepdim=True))
        vectors.append(v)
    return vectors[0], vectors[1]


def _solver(Q: Tensor | BlockChain) -> Callable[[Tensor], Tensor]:
    """Vectors (..., n) -> Q^-1 times these."""
    if isinstance(Q, Tensor):
        return lambda v: solve_unchecked(Q, v[..., None])[..., 0]
    factors = Q.factored()
    return lambda v: Q.flat(factors.solve(Q.nodes(v)))


def _form(w: Tensor, Q: Tensor | BlockChain, v: Tensor) -> Tensor:
    if isinstance(Q, Tensor):
        return (w[..., None, :] @ Q.to(v.dtype) @ v[..., None])[..., 0, 0]
    return (w * Q.flat(Q.to(v.dtype).times(Q.nodes(v)))).sum(-1)


def _root(square: Tensor) -> Tensor:
    root = square.sqrt()
    return torch.where(root.imag < 0, -root, root)
