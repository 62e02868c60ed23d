"""Whether a state that a user gave is an equilibrium, at rest beside frame a."""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.derivatives import no_derivatives
from ..core.validation import concrete
from ..equations.steady import Configuration, SteadyProblem
from ..nodal.model import Model
from ..state.state import State

# of the scaled residual: below it a state is taken without a further look
CLOSE = {torch.float64: 1e-6, torch.float32: 1e-3}
OFF = 1e-3  # rad: how far what is out of balance, or the motion, may bend the beam


def check_balance(problem: SteadyProblem, x: Configuration) -> None:
    """ValueError where what is out of balance in a sample of x, in the coordinates of the model's
    space, could bend the beam by more than `OFF`. Costs one residual.
    """
    with no_derivatives():
        residual = problem.residual(x)[0]
        size, p = residual.measure(), problem.model.space.dims.position
        if not problem.model.station_count:
            _refuse(
                ~(size <= CLOSE[size.dtype]),
                "{} that is no equilibrium was given (what is out of balance is {:.2g} of its "
                "largest force); one under these loads and inputs, as of `equilibrium`, is wanted",
                size,
            )
            return
        free, gap = (residual.nodes * problem.model.constraints.moving).abs(), residual.strain.abs()
        length, soft = problem.model.length.sum((-1, -2)), softest(problem.model)
        force, moment = (v.sum((-1, -2)) for v in (free[..., :p], free[..., p:]))
        stretch, bent = (v.amax((-1, -2)) for v in (gap[..., :p], gap[..., p:]))
        off = force * length**2 / soft, moment * length / soft, stretch, bent * length
        off = torch.stack(torch.broadcast_tensors(*off)).amax(0)
        _refuse(
            ~((size <= CLOSE[size.dtype]) | (off <= OFF)),
            "{} that is no equilibrium was given (what is out of balance is {:.2g} of its largest "
            "force, and {:.2g} of what bends the beam by 1 rad); one under these loads and "
            "inputs, as of `equilibrium`, is wanted",
            size,
            off,
        )


def check_rest(problem: SteadyProblem, state: State) -> None:
    """`check_balance` of a state in the coordinates of the model's space, and ValueError where a
    sample moves beside frame a, with an energy that could bend the beam by more than `OFF`.
    """
    model, space = problem.model, problem.model.space
    x = Configuration(state.position, state.rotation, state.stress)
    with no_derivatives():
        velocity, spin = problem.velocity(x)
        velocity, spin = state.velocity - velocity, state.spin - space.to_section(x.rotation, spin)
        energy = model.kinetic_energy(x.position, x.rotation, velocity, spin)
        # bodies alone do not
        bends = OFF**2 * softest(model) / model.length.sum((-1, -2)) if model.station_count else 0.0
        still = energy <= bends
        fast, turning = (torch.linalg.vector_norm(v, dim=-1).amax(-1) for v in (velocity, spin))
        _refuse(
            ~still,
            "{} that moves was given, by up to {:.3g} m/s and {:.3g} rad/s beside frame a; one at "
            "rest there, as of `equilibrium`, is wanted (steady rotation is that of a `Frame`)",
            fast,
            turning,
        )
    check_balance(problem, x)


def softest(model: Model) -> Tensor:
    """(...) N m^2, the smallest stiffness of bending or torsion."""
    C = model.law.C
    return (C[..., 0] if C.shape[-1] == 1 else C.diagonal(dim1=-2, dim2=-1))[
        ..., model.space.dims.position :
    ].amin((-1, -2))


def _refuse(bad: Tensor, sentence: str, *numbers: Tensor) -> None:
    """`sentence` with the first sample that is `bad` (...) and its numbers."""
    bad = concrete(bad)
    if not bad.any():
        return
    first = tuple(bad.nonzero()[0].tolist())
    which = (
        "a state"
        if not first
        else f"a state (sample {first[0] if len(first) == 1 else first} of {tuple(bad.shape)})"
    )
    raise ValueError(
        sentence.format(which, *(float(concrete(v).expand_as(bad)[first]) for v in numbers))
    )
