"""Whether a state that a user gave is an equilibrium, at rest beside frame a."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..state.state import State
from .mechanism import braced
from .steady import Configuration, SteadyProblem

CLOSE = {torch.float64: 1e-6, torch.float32: 1e-3}  # of the scaled residual: below it a state is taken without a further look
OFF = 1e-3  # lengths of the beam and rad: how far an equilibrium may be, and how far the motion may bend the beam


def check_balance(problem: SteadyProblem, x: Configuration) -> None:
    """ValueError where a sample of x, in the coordinates of the model's space, is further than `OFF` from an equilibrium: the
    move that Newton's method would make. Costs one residual where x is one.
    """
    with no_derivatives():
        residual, *about = problem.residual(x)
        size = residual.measure()
        doubtful = ~(size <= CLOSE[size.dtype])
        if not concrete(doubtful).any():
            return
        move = braced(problem, x).linearise(problem.apply_supports(x), *about).solve(residual.nodes, residual.strain)[0]
        p = problem.model.space.position
        length = problem.model.length.sum((-1, -2))
        far = torch.maximum(move[..., :p].abs().amax((-1, -2)) / length, move[..., p:].abs().amax((-1, -2)))
        _refuse(doubtful & ~(far <= OFF), "{} that is no equilibrium was given (out of balance by {:.2g} of its largest force, "
                "and {:.2g} of the length, or rad, away from one); one under these loads and inputs, as of `equilibrium`, is "
                "wanted", size, far)


def check_rest(problem: SteadyProblem, state: State) -> None:
    """`check_balance` of a state in the coordinates of the model's space, and ValueError where a sample moves beside frame a,
    with an energy that could bend the beam by more than `OFF`.
    """
    model, space = problem.model, problem.model.space
    x = Configuration(state.position, state.rotation, state.stress)
    with no_derivatives():
        velocity, spin = problem.velocity(x)
        velocity, spin = state.velocity - velocity, state.spin - space.to_section(x.rotation, spin)
        C = model.law.C
        stiffness = (C[..., 0] if C.shape[-1] == 1 else C.diagonal(dim1=-2, dim2=-1))[..., space.position:].amin((-1, -2))
        energy = model.kinetic_energy(x.rotation, velocity, spin)
        still = energy <= OFF**2 * stiffness / model.length.sum((-1, -2))
        fast, turning = (torch.linalg.vector_norm(v, dim=-1).amax(-1) for v in (velocity, spin))
        _refuse(~still, "{} that moves was given, by up to {:.3g} m/s and {:.3g} rad/s beside frame a; one at rest there, as "
                "of `equilibrium`, is wanted (steady rotation is that of a `Frame`)", fast, turning)
    check_balance(problem, x)


def _refuse(bad: Tensor, sentence: str, *numbers: Tensor) -> None:
    """`sentence` with the first sample that is `bad` (...) and its numbers."""
    bad = concrete(bad)
    if not bad.any():
        return
    first = tuple(bad.nonzero()[0].tolist())
    which = "a state" if not first else f"a state (sample {first[0] if len(first) == 1 else first} of {tuple(bad.shape)})"
    raise ValueError(sentence.format(which, *(float(concrete(v).expand_as(bad)[first]) for v in numbers)))
