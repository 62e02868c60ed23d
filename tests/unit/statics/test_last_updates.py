"""What is left of the balances of an equilibrium that is returned: less than what Newton's method
has to reach, though its last update is not measured.
"""

import pytest
import torch

import torchbeam as tb
from torchbeam.core.derivatives import no_derivatives
from torchbeam.equations.steady import Configuration, SteadyProblem
from torchbeam.nodal.discretise import discretise
from torchbeam.solvers.newton import TOLERANCE

DTYPE = torch.float64
SECTION = tb.Section.from_stiffness(EA=1e5, GA=4e4, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-6)
BEAM = tb.Beam.straight(1.0, 6, SECTION)
EULER = torch.pi**2 / 4  # N


def left(scene, state):
    """(...) scaled, in all of the loads."""
    model, one = discretise(scene), torch.ones((), dtype=DTYPE)
    x = model.space.to_reduced(state)
    problem = SteadyProblem(model, 0 * one, {}, one)
    with no_derivatives():
        return problem.residual(Configuration(x.position, x.rotation, x.stress))[0].measure()


def tips():
    """Forces that bend a cantilever by 0.01 to 2 rad, anywhere."""
    random = torch.Generator().manual_seed(0)
    force = torch.randn(200, 3, dtype=DTYPE, generator=random)
    size = 10 ** (3 * torch.rand(200, 1, dtype=DTYPE, generator=random) - 1)
    return tb.Scene(BEAM, [tb.TipLoad(force=size * force)])


def column(side):
    """0.5 to 3 times Euler's load, and forces from the side of up to so much (N)."""
    push = torch.linspace(0.5, 3.0, 5, dtype=DTYPE) * EULER
    force = torch.stack((-push, side * torch.linspace(0, 1, 5, dtype=DTYPE) ** 4, 0 * push), -1)
    return tb.Scene(BEAM, [tb.TipLoad(force=force)])


STABLE = dict(branch="stable")
CASES = {
    "tips, eager": (tips(), dict(engine="eager")),
    "tips": (tips(), {}),
    "columns": (column(1e-2), {}),
    "stable branches": (column(1e-2), STABLE),
    "round columns": (column(0.0), STABLE),  # which may bend to any side
}


@pytest.mark.filterwarnings("ignore:sample")  # of what is unstable, and of what turns freely
@pytest.mark.parametrize(("scene", "options"), CASES.values(), ids=CASES)
def test_what_is_returned_is_in_balance(scene, options):
    with no_derivatives():
        state = tb.equilibrium(scene, throw=False, **{"engine": "compiled"} | options)
    assert (state.status == 0).all()
    assert left(scene, state).max() < TOLERANCE[DTYPE]
