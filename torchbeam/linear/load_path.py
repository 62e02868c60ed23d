"""Load path: a scene at any load factor, with its equilibrium, its matrices M, D, K and the slowest
of its eigenvalues.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..core.arguments import function as check_function
from ..core.derivatives import no_derivatives
from ..core.status import statuses
from ..core.validation import concrete, refusal, unmapped
from ..math.null_vectors import bilinear, null_vectors
from ..math.quadratic_eigen import definite, error, plus, rounding, slow_first, slow_values
from ..math.shapes import broadcast_shapes
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..scene.in_double import widened
from ..scene.scene import Scene
from ..state.state import State
from ..statics.equilibrium import equilibrium
from ..statics.mechanism import unheld
from .system_matrices import in_basis, of_chain, of_nodes

STABLE, DIVERGENCE, FLUTTER, LOST = range(4)
COMPLEX = 1e-5  # |Im s| / |s| from which on a pair has met; it counts 1e-10 of the load
APART = 1e-4  # of a structure, and rad: shapes that differ by more are two
GROWING = 1e-6  # Re(lambda) / |lambda| from which on a damped motion grows
Factored = Callable[[Tensor], Scene]
Matrices = tuple[Any, Any, Any]  # M, D, K: tensors, or chains


class Spectrum(NamedTuple):
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


def _apart(a: State, b: State) -> Tensor:
    """(...) bool: whether two shapes are not the same."""
    size = (b.position - b.position[..., :1, :]).abs().amax((-1, -2))
    off = (a.position - b.position).abs().amax((-1, -2)) > APART * size
    cosine = (a.rotation * b.rotation).sum(-1).abs()
    return off | (cosine < 1 - APART**2).any(-1)


class LoadPath:
    """The scene at any load factor: equilibrium, matrices, eigenvalues. start: a shape that
    equilibria are found from, None = the undeformed one.
    """

    def __init__(
        self,
        scene: Factored | Scene,
        inputs: dict[str, Any] | None,
        t: float,
        lumped: bool,
        count: int,
        engine: str,
        wide: bool,
    ) -> None:
        """wide: scenes in single precision are solved in double, see `in_double`."""
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
        self.engine = engine
        self.damped, self.device = False, scene.device if isinstance(scene, Scene) else None
        self.start: State | None = None
        self.turned = False  # whether supports do
        self.wide, self.single = wide, isinstance(scene, Scene) and scene.dtype == torch.float32

    def scene(self, factor: Tensor) -> tuple[Scene, dict[str, Tensor]]:
        scene, inputs = self._as_given(factor)
        if scene.small:
            raise refusal("a scene with small=True", "one of large rotations (small=False)")
        self.single = scene.dtype == torch.float32
        if not (self.single and self.wide):
            return scene, inputs
        return scene.to(torch.float64), widened(inputs)

    def _as_given(self, factor: Tensor) -> tuple[Scene, dict[str, Tensor]]:
        """In the scene's own precision."""
        if isinstance(self.of, Scene):
            values = self.of.tensors(self.inputs)
            return self.of, {
                name: factor[..., None].to(value) * value for name, value in values.items()
            }
        scene = self.of(factor.float() if self.single else factor)
        if not isinstance(scene, Scene):
            raise ValueError(
                f"a function that returns {type(scene).__name__} was given; one that returns a "
                "Scene is wanted"
            )
        return scene, scene.tensors(self.inputs)

    def _factor(self, factor: float) -> Tensor:
        return torch.tensor(factor, dtype=torch.float64, device=self.device)

    def batch_shape(self, lowest: float) -> torch.Size:
        scene, inputs = self.scene(self._factor(lowest))
        self.device = scene.device
        return broadcast_shapes(scene.batch_shape, *(v.shape[:-1] for v in inputs.values()))

    def loose(self, factor: float) -> str:
        """Rigid motions that nothing holds, in words."""
        scene, inputs = self.scene(self._factor(factor))
        t = torch.as_tensor(self.t, dtype=scene.dtype, device=scene.device)
        return unheld(discretise(scene), t, inputs, (0,) * len(self.batch_shape(factor)))[1]

    def equilibrium(self, factor: Tensor, start: State | None) -> State:
        """At a factor (...), from a shape on; supports that turn lead there from the beginning, as
        a shape does not tell how often they have.
        """
        scene, inputs = self.scene(factor)
        self.turned = any(support.turn is not None for support in scene.supports)
        start = None if self.turned else start
        with warnings.catch_warnings(), statuses():
            # of unstable branches and failed samples: they are what is looked for
            warnings.simplefilter("ignore", RuntimeWarning)
            return equilibrium(
                scene, initial=start, t=self.t, throw=False, engine=self.engine, inputs=inputs
            )

    def branch(self, factor: Tensor) -> State:
        """Equilibria at factors (P, ...) in order, on one branch: load steps from no load on may
        come to another one where there are several. Where that of a factor is not what Newton's
        method finds from the one before, they are found one from another from there on.
        """
        each = self.equilibrium(factor, None)
        unmapped("critical_load", each.status)
        if self.turned:
            return each
        again = self.equilibrium(factor[1:], each[:-1])
        other = (again.status == 0) & ((each.status[1:] != 0) | _apart(again, each[1:]))
        if not other.any():
            return each
        first = int(other.flatten().nonzero()[0]) // other[0].numel()
        shapes = [each[k] for k in range(first + 1)]
        for k in range(first + 1, len(factor)):
            shape = self.equilibrium(factor[k], shapes[-1])
            shapes.append(each[k] if (shape.status != 0).any() else shape)
        return State.stack(shapes)

    def go_on(self, factor: Tensor, states: State, low: Tensor) -> None:
        """From the last of equilibria at factors (P, ...), in order, that is not above `low`."""
        for k, at in enumerate(factor):
            start = states[k] if self.start is None else self.start
            self.start = states[k].where(low >= at, start)

    def matrices(
        self, factor: Tensor, near: Tensor | None = None, state: State | None = None
    ) -> tuple[Model, State, Matrices, Tensor | None]:
        """M, D, K: of a long chain as such, else dense, with their basis, near another one; in an
        equilibrium, None = that which is come to from `start`.
        """
        scene, inputs = self.scene(factor)
        state = self.equilibrium(factor, self.start) if state is None else state
        model = discretise(scene, self.lumped)
        t = torch.as_tensor(self.t, dtype=scene.dtype, device=scene.device)
        M, D, K, lagging = of_nodes(model, state, t, inputs)
        undamped = D is None and lagging is None
        chains = of_chain(model, M, K, self.count) if undamped else None
        if chains is not None:
            return model, state, (chains[0], None, chains[1]), None
        return model, state, *in_basis(model, M, D, K, lagging, near)

    def spectrum(self, factor: Tensor, state: State | None = None) -> Spectrum:
        model, state, (M, D, K), _ = self.matrices(factor, state=state)
        self.damped = D is not None
        value, vectors = slow_values(M, D, K, self.count)
        slow = slow_first(value, self.count, self.damped)
        if self.damped:  # and the slowest of all: those that decay are the next to diverge
            slow = torch.cat((slow, slow_first(value, self.count, False)), -1)
        value = value.gather(-1, slow)
        heavy = torch.isfinite(value)  # others have no inertia, and are as fast as may be
        value = torch.where(heavy, value, -torch.inf)
        vectors = vectors.gather(-1, slow[..., None, :].expand(*vectors.shape[:-1], -1))
        real, size, unknown = value.real, value.abs(), rounding(M, K, vectors)
        turning = value.imag > COMPLEX * size
        # s is real, whatever rounding makes of it where K is next to singular
        if model.conservative and not self.damped:
            turning = torch.zeros_like(turning)
        if self.damped:  # growth that rounding may have made is none
            flutter = torch.where(turning, real, -torch.inf)
            grows = real > torch.maximum(GROWING * size, error(M, D, K, value, vectors))
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
        if model.conservative and not self.damped and not concrete(heavy.all()):
            # whether one of those buckles, stiffness tells alone
            kind = torch.where(definite((K + K.mT) / 2), STABLE, DIVERGENCE)
        kind = torch.where(state.status == 0, kind, LOST).expand(factor.shape)
        slack = (size.square() if self.damped else size) <= unknown
        neutral = (heavy & slack).any(-1).expand(factor.shape)
        leading = value.gather(-1, which[..., None])[..., 0]
        return Spectrum(value[..., : self.count], kind, neutral, divergence, flutter, leading)

    def crossing(self, low: Tensor, high: Tensor, kind: Tensor) -> tuple[Tensor, Tensor]:
        """Zero of the measure, by a straight line through its values at the two ends, undamped
        flutter's (a square above, nothing below) beyond the upper end; and the eigenvalue there.
        """
        width = high - low
        below, above, beyond = (self.spectrum(x) for x in (low, high, high + width))
        if self.damped:  # the motion that grows, where others may be nearer to growth
            near = (below.eigenvalue - above.leading[..., None]).abs().argmin(-1, keepdim=True)
            same = below.eigenvalue.gather(-1, near)[..., 0]
            below = below._replace(
                flutter=torch.where(kind == FLUTTER, same.real, below.flutter),
                leading=torch.where(kind == FLUTTER, same, below.leading),
            )
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
            v, w = null_vectors(Q)
            scale = bilinear(w, slope, v) if self.damped else torch.ones_like(leading)
            scale = torch.where(kind == FLUTTER, scale, bilinear(w, Q.abs(), v).abs().to(v.dtype))
        shape = v if isinstance(Q, Tensor) else v[..., model.constraints.unknowns.grouped]
        return (
            model,
            lambda factor: (bilinear(w, parts(factor, basis)[1], v) / scale).real,
            shape,
            basis,
        )
