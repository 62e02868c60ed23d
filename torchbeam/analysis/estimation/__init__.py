"""Estimation while a structure moves: filters and smoothers of its state and parameters."""
