"""The list of verification cases."""

from . import motion, rotating, stability, statics, tendons, wing

CASES = [
    *statics.CASES,
    *stability.CASES,
    *wing.CASES,
    *motion.CASES,
    *rotating.CASES,
    *tendons.CASES,
]
