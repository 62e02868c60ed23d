"""Uncertainty: laws of random parameters, samples in chunks, answers with errors, sensitivities,
rare events.
"""
