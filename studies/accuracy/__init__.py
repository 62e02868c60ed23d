"""Work and precision: which setting is cheapest for an error, over motions, elements and
methods.
"""

from .command import main

__all__ = ["main"]
