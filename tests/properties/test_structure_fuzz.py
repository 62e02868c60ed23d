"""Random structures said otherwise: turned, in other units, in batches, restarted, with beams cut
and welded; and their derivatives beside differences.
"""

import pytest

from tests.cases.structure_fuzz import JOINTS, distances, draw

SHORT = 0, 130  # every joint, bodies, a beam that is cut, order 2 and both methods
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


def test_every_joint_is_drawn():
    drawn = {joint for seed in SHORT for joint in draw(seed).joints}
    assert set(JOINTS) <= drawn
