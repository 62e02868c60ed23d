"""Effects: what acts on a beam besides its own elasticity and inertia. Only what a scene names exists.

An effect is a small frozen dataclass with one hook:
    load         force and moment that act on sites of the beam: `wrench(site, t, inputs)`, `tangent(site, t, inputs)`
    strain       `Damping`: stress that follows the strain rate
    inertia      `PointMass`: mass at a node
    eigenstrain  `Actuation`: strain and curvature that the beam takes by itself
A load acts on one node (`node` is an index) or along the beam, per unit length (`node` is None). Sites may be nodes or
elements: an effect does not know which form of the beam asks.
"""

from .actuation import Actuation
from .damping import Damping, MassDamping, rayleigh
from .drag import Drag
from .gravity import Gravity
from .loads import LineLoad, PointLoad, TipLoad
from .mass import PointMass
from .records import Accelerogram, History
from .site import ACCELERATION, POSITION, ROTATION, SPIN, VELOCITY, Acting, Effect, Pose, Site, Wrench, jacobians, together
from .springs import RootSpring, Spring
from .user import Load
from .values import Along, Input, Inputs, LoadValue, PerElement, of_time, plain, value_along, value_at

__all__ = [
    "ACCELERATION",
    "POSITION",
    "ROTATION",
    "SPIN",
    "VELOCITY",
    "Accelerogram",
    "Acting",
    "Actuation",
    "Along",
    "Damping",
    "Drag",
    "Effect",
    "Gravity",
    "History",
    "Input",
    "Inputs",
    "LineLoad",
    "Load",
    "LoadValue",
    "MassDamping",
    "PerElement",
    "PointLoad",
    "PointMass",
    "Pose",
    "RootSpring",
    "Site",
    "Spring",
    "TipLoad",
    "Wrench",
    "jacobians",
    "of_time",
    "plain",
    "rayleigh",
    "together",
    "value_along",
    "value_at",
]
