"""The way up from no load keeps to the branch that it is on."""

import warnings

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=(1.0, 1.3), mass=0.2)
FORCES = torch.tensor(
    [
        [-4.34, 0.58, 1.21],
        [-4.86, -0.01, 1.99],
        [-13.79, -3.88, 1.53],
        [-4.82, -0.29, -0.1],
        [-7.87, -1.04, -2.16],
    ]
)


@pytest.mark.steps
def test_large_forces_lead_to_no_other_branch():
    """Cantilevers under forces of two to six times Euler's load and their weight, which Newton's
    method took in a step of seven and more iterations to a branch that is unstable, 1.3 m away:
    they come where a path by arc length leads, which is stable.
    """
    pytest.importorskip("llvmlite")
    scene = tb.Scene(
        tb.Beam.straight(1.0, 8, SECTION), [tb.TipLoad(force=FORCES), tb.Gravity((0, 0, -9.81))]
    )
    path = tb.path(scene, step=0.2)
    assert path.reached.all() and path.stable[-1].all()
    for engine in ("eager", "compiled"):
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # of one that is unstable
            found = tb.equilibrium(scene, engine=engine)
        assert_close(found.tip.position, path.state[-1].tip.position, rtol=0, atol=1e-6)
