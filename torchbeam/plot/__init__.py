"""Pictures of beams and their motions (extra `plot`: matplotlib).

    ax = tb.plot.shape(solution.state[::10])
    each function takes axes or makes new ones, and returns them
    tb.plot.save(ax, "out/shapes.png")
    tb.plot.animate(solution, "out/motion.gif")

Figures belong to nobody but the caller: pyplot, its state and its windows are not used.
"""

from ..core.entry_point import entry_points
from ..core.missing_name import by_word, near_names
from .animation import animate
from .canvas import axes, grid, save
from .cross_sections import cross_section
from .curves import campbell, energies, history, load_path, tried
from .diagrams import diagram
from .identification import correlation, design, fit, profile
from .mode_shapes import mode_film, mode_shapes, orbits
from .obstacles import obstacles
from .reactions import reactions
from .shapes import shape
from .symbols import symbols
from .tendons import tendons
from .uncertainty import bands, convergence, histogram, tornado

# fmt: off
__all__ = [
    "animate", "axes", "bands", "campbell", "convergence", "correlation", "cross_section", "design",
    "diagram",
    "energies",
    "fit", "grid", "histogram", "history", "load_path", "mode_film", "mode_shapes", "obstacles",
    "orbits", "profile", "reactions", "save", "shape", "symbols", "tendons", "tornado", "tried",
]
# fmt: on

entry_points(globals(), __all__)

# what others call so
ELSEWHERE = by_word(
    {
        "animate": "film movie",
        "diagram": "bendingmoment moment shear",
        "save": "savefig show",
        "shape": "deflection deformed plot",
    }
)
near_names(globals(), ELSEWHERE)
