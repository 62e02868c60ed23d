"""What the library offers of sections from geometry, imported where it is asked for."""

from ..core.entry_point import entry_points
from .cross_section import CrossSection
from .material import Material

__all__ = ["CrossSection", "Material"]

entry_points(globals(), __all__)
