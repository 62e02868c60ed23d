"""Scenes: sections, beams, supports, prescribed motions, effects."""
