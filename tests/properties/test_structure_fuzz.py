"""Random structures said otherwise: turned, in other units, in batches, restarted, with beams cut
and welded; and their derivatives beside differences.
"""

import pytest

from tests.cases.structure_fuzz import JOINTS, build, distances, draw, run

# every joint, obstacle and tendon, bodies, a beam that is cut, both orders and both methods
SHORT = 969, 8653
LIMITS = {"gradient": 1e-5}  # differences of 1e-5 of what is of second order in them


def distances_within_limits(seed):
    for name, distance in distances(seed).items():
        limit = LIMITS.get(name.split()[0], 1e-8 if "forces" in name else 1e-11)
        assert distance < limit, (name, distance, draw(seed))


@pytest.mark.parametrize("seed", SHORT)
def test_structures_said_otherwise(seed):
    """Places after two steps to 1e-11, forces of joints and supports to 1e-8: they are those of
    stiffnesses of 1e3 N times what steps leave of their residual."""
    distances_within_limits(seed)


@pytest.mark.long
def test_many_structures_said_otherwise():
    for seed in range(10_000, 10_300):
        distances_within_limits(seed)


@pytest.mark.long
def test_many_structures_are_stepped_alike_by_both_engines():
    """1e-11 of the largest: stiffnesses of 1e3 N times the rounding of places."""
    for seed in range(20_000, 20_030):
        drawn = draw(seed)
        if "beam" not in drawn.kinds:
            continue
        native, eager = (
            run(build(drawn), drawn, engine=engine) for engine in ("compiled", "eager")
        )
        for name in ("position", "rotation", "velocity", "spin", "stress", "reaction", "joints"):
            a, b = getattr(native, name), getattr(eager, name)
            if b is not None and b.numel():
                error = float((a - b).abs().max() / b.abs().max().clamp(min=1.0))
                assert error < 1e-11, (name, error, drawn)


def test_everything_is_drawn():
    drawn = [draw(seed) for seed in SHORT]
    assert set(JOINTS) <= {joint for one in drawn for joint in one.joints}
    assert {one.obstacle for one in drawn} == {"plane", "sphere"}
    assert {one.tendon for one in drawn} == {"pulled", "elastic"}
