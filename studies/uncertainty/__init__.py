"""Uncertainty from the command line: runs by a configuration file, coverage of intervals, cost of
samples.
"""
