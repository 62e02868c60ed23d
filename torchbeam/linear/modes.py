"""Modes of small motions about an equilibrium: natural frequencies, damping, stability.

With a the moves (displacement, spin) of the free nodes and M, D, K the mass, damping and tangent
stiffness there, the last with the stress and the loads that turn (so K need not be symmetric):  M
a'' + D a' + K a = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..core.arguments import choice, instant, not_here
from ..core.arguments import count as check_count
from ..core.derivatives import no_derivatives
from ..core.leaves import wants_gradient
from ..core.one_thread import dense_numbers_of, few_on_one_thread
from ..core.summary import counted, kind, lines, span
from ..core.validation import concrete, shown
from ..core.warning import warn
from ..equations.steady import Configuration, Past, SteadyProblem
from ..math.eigen_derivatives import attach, upright
from ..math.quadratic_eigen import DOUBT, Pairs, slowest, slowest_of_chain
from ..nodal.discretise import discretise
from ..nodal.model import Model
from ..scene.in_double import in_double
from ..scene.scene import Scene
from ..state.state import State
from ..statics.equilibrium import equilibrium
from ..statics.mechanism import unheld
from ..topology.protocols import Matrix
from .system_matrices import at_rest, augmented, dense, free_moves, moves, of_chain, of_nodes

# real part over |eigenvalue| from which on a motion grows: where eigenvalues meet, rounding counts
# by its root
GROWING = 1e-6
NORMS = ("largest", "mass")


@dataclass(frozen=True)
class Modes:
    """The slowest motions x exp(eigenvalue t), one of each conjugate pair, by frequency; those that
    decay without oscillating last.

    Args:
        eigenvalue: (..., count) complex, 1/s; a positive real part grows
        shape: (..., count, N+1, 6) complex: displacement (m) and rotation (rad) of the nodes, frame
            a
        state: the equilibrium about which they are

    Examples:
        >>> modes = tb.modes(scene, count=2)
        >>> modes.frequency / (2 * torch.pi)  # Hz
        tensor([1.8410, 7.8660])
        >>> modes.shape.shape  # modes, nodes, moves and turns
        torch.Size([2, 5, 6])
    """

    eigenvalue: Tensor
    shape: Tensor
    state: State | None = None

    @property
    def summary(self) -> dict[str, str]:
        """Each mode in words, of a batch from the least to the largest."""
        unstable = concrete(self.unstable)
        return {
            f"mode {k + 1}": (
                f"{span(self.frequency[..., k] / (2 * torch.pi))} Hz, damping ratio "
                f"{span(self.damping_ratio[..., k])}{', unstable' * bool(unstable[..., k].any())}"
            )
            for k in range(self.eigenvalue.shape[-1])
        }

    def __repr__(self) -> str:
        grow = int(concrete(self.unstable).sum())
        return lines(
            "Modes",
            f"{counted(self.frequency.shape[-1], 'frequency', 'frequencies')} "
            f"{span(self.frequency)} rad/s",
            f"damping ratio {span(self.damping_ratio)}",
            *([f"{grow} unstable"] if grow else []),
            kind(self.frequency.shape[:-1], self.frequency),
        )

    @property
    def frequency(self) -> Tensor:
        """(..., count) rad/s, damped: |imaginary part|; 0 for a motion that does not oscillate."""
        return self.eigenvalue.imag.abs()

    @property
    def natural(self) -> Tensor:
        """(..., count) rad/s, undamped: |eigenvalue|. `frequency` is sqrt(1 - zeta^2) times it."""
        return self.eigenvalue.abs()

    @property
    def damping_ratio(self) -> Tensor:
        """(..., count) -real part / |eigenvalue|: 1 for no oscillation, below 0 for growth."""
        size = self.eigenvalue.abs()
        return -self.eigenvalue.real / torch.where(size == 0, 1, size)

    @property
    def unstable(self) -> Tensor:
        """(..., count) bool: grows, beyond rounding."""
        return self.eigenvalue.real > GROWING * self.eigenvalue.abs()

    @property
    def divergence(self) -> Tensor:
        """(..., count) bool: grows without oscillating, as a buckled column does."""
        return self.unstable & (self.eigenvalue.imag.abs() <= GROWING * self.eigenvalue.abs())

    @property
    def flutter(self) -> Tensor:
        """(..., count) bool: grows and oscillates."""
        return self.unstable & ~self.divergence


@few_on_one_thread(dense_numbers_of)
def modes(
    scene: Scene,
    state: State | None = None,
    count: int = 6,
    *,
    normalize: str = "largest",
    t: float = 0.0,
    lumped: bool = False,
    inputs: dict[str, Any] | None = None,
    accuracy: Any = None,
) -> Modes:
    """Frequencies with their damping ratios, and mode shapes (nodal form).

    Args:
        state: an equilibrium of the scene; None = the equilibrium under its loads at time t (s)
        count: pairs of eigenvalues, the slowest first, behind them motions that decay without
            oscillating, the slowest first; an overdamped pair counts as two of these
        normalize: of the shapes: "largest", their largest entry is 1; "mass", v^H M v = 1 kg m^2,
            their largest entry real
        lumped: as in `Stepper`: the mass of the explicit form
        inputs: of the scene by name, (..., size)
        accuracy: relative, of the magnitudes of the eigenvalues: on a mesh of its own choice, see
            `simulate`

    - **Loads.** Follower loads are in K: flutter is a positive real part, divergence a positive
      eigenvalue without frequency.
    - **Sections** without rotary inertia are taken as they are. An infinite stiffness is a very
      large one here; its own modes, far above the others, mean nothing.
    - **Cost.** An undamped beam under conservative loads has a symmetric solver, and with more than
      96 unknowns subspace iteration, O(N). Everything else has a dense unsymmetric solver, O(N^3).
    - **Derivatives.** Eigenvalues and shapes are differentiable. Repeated ones (equal bending in
      two planes) have no derivative by themselves, and asking for it raises a RuntimeError.
    - **Precision.** A scene in single precision is solved in double, and the answer rounded:
      stretching is so much stiffer than bending that float32 would lose the slowest modes. If its
      functions return only single precision, all is single, with a warning.
    - **Overdamped** motions and those of internal states of loads, which the dense solver has as
      unknowns, decay without oscillating. They come last, however slow; rigid ones, of eigenvalue
      0, come first. `Linear.poles` has all eigenvalues.

    Raises:
        ValueError: for more modes than the mesh has, or than have inertia. For a state that moves
            or is no equilibrium, or a scene that the nodal form does not take.

    Examples:
        >>> modes = tb.modes(tb.Scene(beam), count=2)
        >>> modes.frequency / (2 * torch.pi)  # Hz
        tensor([ 1.6252, 10.9443])
    """
    not_here("accuracy", accuracy, "torchbeam.modes")
    choice("normalize", normalize, NORMS)
    model = discretise(scene, lumped)
    check_count("count", count)
    values, time = scene.tensors(inputs), instant("t", t, scene.beam.nodes)
    if isinstance(state, int):
        raise ValueError(
            f"state = {shown(state)} was given to modes; a torchbeam.State is wanted, or "
            f"count={shown(state)} for so many"
        )
    if state is not None:
        at_rest(model, state, time, values, lumped)

    def found(scene: Scene, state: State | None, values: dict[str, Tensor], t: Tensor) -> Modes:
        if state is None:
            state = equilibrium(scene, t=t.item(), inputs=values)
        discretised = model if scene is model.scene else discretise(scene, lumped)
        return _modes(discretised, state, count, normalize, values, t)

    return in_double(found, scene, state, values, time)


def _modes(
    model: Model, state: State, count: int, normalize: str, inputs: dict[str, Tensor], time: Tensor
) -> Modes:
    """`modes`, about an equilibrium."""
    free = model.constraints.count - model.multipliers.held_count
    if count > free:
        raise ValueError(
            f"count = {count} was given; {model.scene.beam.element_count} elements have at most "
            f"{free} modes"
        )
    M, D, K, lags = of_nodes(model, state, time, inputs)
    mass = M
    derivatives = wants_gradient(
        *(x for matrix in (M, D, K) if matrix is not None for x in matrix.tensors), *(lags or ())
    )
    symmetric = D is None and lags is None and model.conservative
    pairs = None
    if symmetric:
        with no_derivatives():
            chains = of_chain(model, M, K, count)
            if chains is not None:
                pairs = slowest_of_chain(*(x.symmetrised() for x in chains), count)
            if pairs is not None:
                right = pairs.right[..., model.constraints.unknowns.grouped]
                pairs = pairs._replace(right=right)
    basis = free_moves(model, K)
    if pairs is None or derivatives or normalize == "mass":
        M, D, K = augmented(
            model,
            *(None if matrix is None else dense(model, matrix, basis) for matrix in (M, D, K)),
            lags,
            basis,
        )
    if pairs is None:
        with no_derivatives():
            pairs = slowest(M, D, K, count, symmetric, derivatives, model.lag_count)
    if not (each := concrete(pairs.known)).all():
        known = int(each.sum(-1).amin())
        raise ValueError(
            f"count = {count} was given; of {free} modes {known} have an inertia beyond rounding; "
            f"at most {known} are wanted"
        )
    _warn_of_rounding(model, pairs, time, inputs)
    if symmetric and bool(concrete(pairs.eigenvalue.real > 0).any()):
        pairs = _without_imbalance(model, pairs, state, mass, basis, time, inputs)
    value, shape = (
        attach(M, D, K, pairs) if derivatives else (pairs.eigenvalue, upright(pairs.right)[0])
    )
    if lags is not None:
        M, shape = M[..., :free, :free], upright(shape[..., :free])[0]
    if normalize == "mass":
        shape = (
            shape
            / sum((x * (x @ M)).sum(-1, keepdim=True) for x in (shape.real, shape.imag)).sqrt()
        )
    shape = moves(model, shape, None if basis is None else basis[..., None, :, :])
    return Modes(value, shape, state)


def _without_imbalance(
    model: Model,
    pairs: Pairs,
    state: State,
    M: Matrix,
    basis: Tensor | None,
    time: Tensor,
    inputs: dict[str, Tensor],
) -> Pairs:
    """Without the growth that a state that is not quite in balance may have made of a motion that
    nothing resists. What a motion x with turns theta of the nodes makes of the forces r that are
    out of balance, K x, is theta x r there: x^T K x is sum |theta| |x| |r| at most.
    """
    with no_derivatives():
        space, reduced = model.space, model.space.to_reduced(state)
        x = Configuration(reduced.position, reduced.rotation, reduced.stress)
        problem = SteadyProblem(
            model, time, inputs, torch.ones_like(time), past=Past.of(model.scene, reduced)
        )
        shape = pairs.right.real
        wide = moves(model, shape, None if basis is None else basis[..., None, :, :])
        r = space.embed(problem.residual(x)[0].nodes * model.constraints.moving)[..., None, :, :]
        turn = torch.linalg.vector_norm(wide[..., 3:], dim=-1)
        work = (turn * (wide * r).abs().sum(-1)).sum(-1)
        mass = (shape * (shape @ dense(model, M, basis))).sum(-1).abs()
        none = pairs.eigenvalue.real.square() * mass <= work
        value = torch.where(none & (pairs.eigenvalue.imag == 0), 0.0, pairs.eigenvalue)
        return pairs._replace(eigenvalue=value)


def _warn_of_rounding(model: Model, pairs: Pairs, time: Tensor, inputs: dict[str, Tensor]) -> None:
    """Where rounding of the stiffness may move an eigenvalue by more than `DOUBT` of it, or leaves
    nothing of it: it is zero, and no rigid motion's.
    """
    value, doubt, apart = map(concrete, (pairs.eigenvalue, pairs.doubt, pairs.apart))
    none = (value == 0) | (doubt >= 1)
    lost = (none & ~apart).sum(-1)
    # of a damped rigid motion there may be two
    if lost.any() and int(lost.amax()) <= 2 * unheld(model, time, inputs)[0]:
        lost = torch.zeros_like(lost)
    vague = ~none & ~apart & (doubt > DOUBT)
    if lost.any() or vague.any():
        share = "all" if lost.any() else f"{doubt[vague].amax().item():.0%}"
        warn(
            f"stiffnesses that leave rounding to move a slow frequency by up to {share} of it were "
            "given (a very slender beam, or one stiffness very far above another; or nothing "
            "resists a motion); fewer elements, or math.inf for what hardly yields, is wanted",
            UserWarning,
        )
