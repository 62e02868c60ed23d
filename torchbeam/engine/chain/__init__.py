"""Compiled midpoint step: its local functions, and the native pass over the chain that calls
them.
"""
