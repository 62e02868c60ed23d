"""The list of verification cases."""

from . import (
    contact,
    flexible_mechanisms,
    joined_wing,
    knot,
    motion,
    parallel_robot,
    plectoneme,
    pulley,
    ropes,
    rotating,
    stability,
    statics,
    structures,
    tendons,
    touching,
    wing,
)

CASES = [
    *statics.CASES,
    *stability.CASES,
    *wing.CASES,
    *motion.CASES,
    *rotating.CASES,
    *structures.CASES,
    *flexible_mechanisms.CASES,
    *joined_wing.CASES,
    *parallel_robot.CASES,
    *tendons.CASES,
    *pulley.CASES,
    *touching.CASES,
    *contact.CASES,
    *ropes.CASES,
    *knot.CASES,
    *plectoneme.CASES,
]
