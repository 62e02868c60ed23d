"""Basics without physics: declared tensors, validation of input, functions of time, files,
results.
"""
