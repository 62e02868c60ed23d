"""Local functions of a step: what nodes and elements do, summed along the chain, is what the step
does.
"""

import pytest
import torch
from torch.testing import assert_close

from tests.cases.chain_reference import Chain
from tests.cases.compiled_step_cases import SCENES, inputs_of, moving
from torchbeam.equations.midpoint import MidpointProblem
from torchbeam.nodal.discretise import discretise


@pytest.mark.parametrize("name", SCENES)
def test_local_functions_make_the_steps_of_newtons_method(name):
    """Two iterates, the scaled residual, the reactions and the state at the end, each to 1e-12 of
    its largest number; where strains are impossible to 1e-7, as the tangent's condition is 1e7 and
    these iterates have not converged.
    """
    tolerance = 1e-7 if name.startswith("inextensible") else 1e-12
    scene = SCENES[name]()
    model = discretise(scene)
    start = model.space.to_reduced(moving(scene))
    problem = MidpointProblem(model, start, torch.tensor(0.01), torch.tensor(0.3), inputs_of(scene))
    chain, x = Chain(problem), problem.predictor()
    for _ in range(2):
        residual, *about = problem.residual(x)
        *change, reaction = problem.linearise(x, *about).solve(residual.nodes, residual.strain)
        x = problem.update(x, *change)
        size, reactions = chain.iterate()
        # of what has converged, rounding is left
        assert_close(size, residual.measure(), rtol=1e3 * tolerance, atol=1e-11)
        for found, wanted in zip((*chain.x, reactions), (*x, reaction), strict=True):
            close(found, wanted, tolerance)
    after = problem.finish(x, reaction)
    for name, found in chain.finish().items():
        close(found, getattr(after, name) - (start.work if name == "work" else 0), tolerance)


def close(found, wanted, tolerance):
    assert_close(
        found,
        wanted,
        rtol=0,
        atol=tolerance * float(wanted.abs().max() + 1e-3 if wanted.numel() else 1),
    )
