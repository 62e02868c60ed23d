"""Mesh, element, method and step for a wanted accuracy, found by nested refinement."""
