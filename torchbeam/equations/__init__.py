"""Equations of the nodal form: of a step, and of equilibrium."""
