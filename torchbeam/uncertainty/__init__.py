"""Uncertainty: laws of random parameters, samples, sensitivities, rare events, with errors."""
