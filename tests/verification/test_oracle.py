"""Random rods by the library and by a dense reference that shares no line with it
(`python -m studies oracle` takes more).

Errors are those of what three meshes tend to; accepted is what the last refinement changed that by,
see `comparison`.
"""

import numpy as np
import pytest

from studies.oracle import comparison, draws

SEED = 3
LONG = 40


def check(rows, some=True):
    assert rows or not some
    wrong = [
        f"{name}: {error:.1e}, {accepted:.1e} is accepted"
        for name, error, accepted, _ in rows
        if not error <= accepted
    ]
    assert not wrong


def case(net, number):
    return draws.case(np.random.default_rng((SEED, number)), number, moving=net == "motion")


@pytest.mark.filterwarnings("ignore:.*unstable equilibrium:RuntimeWarning")
@pytest.mark.parametrize("number", range(12))
def test_statics(number):
    """All effects, supports and sections in turn."""
    check(comparison.statics(case("statics", number)))


@pytest.mark.filterwarnings("ignore:.*unstable equilibrium:RuntimeWarning")
@pytest.mark.parametrize(
    "number", (0, 5, *(pytest.param(k, marks=pytest.mark.long) for k in (3, 6)))
)
def test_vibrations(number):
    check(comparison.vibrations(case("vibrations", number)))


@pytest.mark.parametrize("number", (pytest.param(6, marks=pytest.mark.long), 7, 11))
def test_motion(number):
    """Momentum, angular momentum, energy, and the power of what acts; frames that turn, a clamp
    that moves.
    """
    check(comparison.motion_by(case("motion", number), meshes=(4, 8, 16), steps=8, span=0.12))


@pytest.mark.parametrize("number", range(6))
def test_hinges(number):
    """Wheels whose hinge yields, or has hysteresis, driven to and fro."""
    rows = comparison.compare("hinges", SEED, number)
    check([(r.quantity, r.error, r.tolerance, r.change) for r in rows])


@pytest.mark.long
@pytest.mark.parametrize("net", comparison.NETS)
def test_all_effects_at_once(net):
    check(
        comparison.NETS[net](
            draws.case(np.random.default_rng(SEED), moving=net == "motion", every=True)
        )
    )


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:.*unstable equilibrium:RuntimeWarning")
@pytest.mark.parametrize("net", comparison.NETS)
@pytest.mark.parametrize("number", range(12, LONG))
def test_more(net, number):
    """A rod that nothing oscillates or moves has no rows."""
    check(comparison.NETS[net](case(net, number)), some=net == "statics")
