"""Equilibria by native code."""
