"""The list of hard cases."""

from . import dynamics, held, statics

CASES = [*dynamics.CASES, *held.CASES, *statics.CASES]
