"""Runaway motions: explicit steps beyond the limit of stability, finite still."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.core.status import FAILED, SUCCESS
from torchbeam.dynamics.runaway import stopped
from torchbeam.nodal.discretise import discretise

SECTION = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.8, EI=1.0, mass=0.2, inertia=1e-3)
BEAM = tb.Beam.straight(1.0, 2, SECTION)


def run(step):
    """20 rk4 steps from rest under a force of 0.3 N, none, and 1 mN; five outputs."""
    force = torch.tensor([[0, 0, 0.3], [0, 0, 0], [0, 0, 1e-3]])
    scene = tb.Scene(BEAM, [tb.TipLoad(force=force)])
    return tb.simulate(
        scene, torch.linspace(0, 20 * step, 5), method="rk4", options={"step_size": step}
    )


def test_a_sample_that_runs_away_keeps_its_last_output():
    """Steps of 5 ms: what they have added to the energy that was given is 0.01, 0.2 and 5 times
    that, and 200 times at the last output, which is not kept. The sample at rest has nothing to run
    away with.
    """
    with pytest.warns(
        RuntimeWarning, match=r"rk4 made energy that nothing gave: .* \(2 of 3 samples\)"
    ):
        found = run(5e-3)
    assert found.status.tolist() == [FAILED, SUCCESS, FAILED]
    assert (
        found.state.status[:-1].eq(SUCCESS).all()
        and "limit of stability" in found.stats.reason[FAILED]
    )
    assert_close(found.nodes[-1], found.nodes[-2], rtol=0, atol=0)
    gained = found.energy.kinetic + found.energy.strain - found.energy.work
    assert gained[-1, 0] > 5 * found.energy.work[-1, 0] and (found.state.t[-1] == found.t[-1]).all()


def test_a_stable_step_is_left_alone(recwarn):
    """3.5 ms: less than 1 % is added."""
    assert not run(3.5e-3).status.any() and not [w for w in recwarn if w.category is RuntimeWarning]


@pytest.mark.parametrize(
    "other",
    [
        dict(effects=[tb.Actuation(curvature=lambda t: torch.stack((0 * t, t, 0 * t)))]),
        dict(
            frame=tb.Frame(velocity=(0.0, 0, 1)),
            supports=[tb.Support(0), tb.Support(-1, position="y", rotation="")],
        ),
    ],
    ids=["changing eigenstrain", "carried by supports"],
)
def test_nobody_knows_energy_from_elsewhere_than_work(other):
    """Such scenes are not judged, nor is their energy asked for."""
    states = run(3.5e-3).state
    found, lost = stopped(discretise(tb.Scene(BEAM, **other)), states, None)
    assert found is states and not lost.any()
