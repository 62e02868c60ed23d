"""The energy-consistent element between nodes that carry position and rotation."""
