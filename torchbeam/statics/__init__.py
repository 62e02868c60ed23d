"""Equilibrium, equilibrium paths, and what holds a beam."""
