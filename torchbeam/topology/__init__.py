"""Topologies: which nodes elements lie between, and the matrices that this makes."""
