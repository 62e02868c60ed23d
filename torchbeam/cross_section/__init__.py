"""Sections from geometry: stiffness, mass and stresses of a cross-section by finite elements."""
