"""The list of verification cases."""

# fmt: off
from . import (  # isort: skip
    statics, stability, wing, motion, rotating, structures, flexible_mechanisms, joined_wing,
    parallel_robot, tendons, pulley, touching, contact, cone, ropes, knot, plectoneme,
    published, measured,
)

MODULES = (
    statics, stability, wing, motion, rotating, structures, flexible_mechanisms, joined_wing,
    parallel_robot, tendons, pulley, touching, contact, cone, ropes, knot, plectoneme,
    published, measured,
)
# fmt: on
CASES = [case for module in MODULES for case in module.CASES]
