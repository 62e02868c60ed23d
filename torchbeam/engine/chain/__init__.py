"""Compiled steps and equilibria: their local functions, and the native drivers that call them."""
