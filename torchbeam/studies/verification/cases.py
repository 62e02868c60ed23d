"""The list of verification cases."""

from . import contact, motion, rotating, stability, statics, structures, tendons, touching, wing

CASES = [
    *statics.CASES,
    *stability.CASES,
    *wing.CASES,
    *motion.CASES,
    *rotating.CASES,
    *structures.CASES,
    *tendons.CASES,
    *touching.CASES,
    *contact.CASES,
]
