"""The list of verification cases."""

from . import motion, rotating, stability, statics, structures, wing

CASES = [
    *statics.CASES,
    *stability.CASES,
    *wing.CASES,
    *motion.CASES,
    *rotating.CASES,
    *structures.CASES,
]
