"""Small motions about an equilibrium: system matrices, modes, linear models, perturbations,
stability limits.
"""
