"""Rotations and linear algebra that know no beam."""
