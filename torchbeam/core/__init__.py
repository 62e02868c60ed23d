"""Basics without physics: declared tensors, checks of input, functions of time, files, results."""
