"""Effects: loads, damping, added masses and eigenstrains. Only what a scene names exists.

An effect is a small frozen dataclass with one kind:
    load         force and moment at load points of the beam: `wrench(point, t, inputs)`,
                 `tangent(point, t, inputs)`
    strain       `Damping`: stress that follows the strain rate
    memory       `Viscoelastic`: stress that relaxes
    inertia      `PointMass`: mass at a node
    eigenstrain  `Actuation`: strain and curvature of the unloaded beam
    tendon       `Tendon`: forces between points of several nodes
    pair         `Contact` of two parts, `SelfContact`
A load acts on one node (`node` is an index) or along the beam, per unit length (`node` is None).
Load points may be nodes or elements, by the form of the beam.
"""

from .actuation import Actuation
from .contact import Contact
from .custom_load import Load
from .damping import Damping, MassDamping, rayleigh
from .drag import Drag
from .drive import Drive
from .dynamic_stall import DynamicStall
from .effect import Effect
from .gravity import Gravity
from .histories import Accelerogram, History
from .load_point import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    INERTIAL,
    POSITION,
    ROTATION,
    SPIN,
    VELOCITY,
    LoadEffect,
    LoadPoint,
    Pose,
)
from .loads import LineLoad, PointLoad, TipLoad
from .obstacle import Obstacle
from .obstacles import Box, Capsule, Cylinder, Plane, Sphere
from .point_mass import PointMass
from .polar import Polar
from .rotor import Induction, blade_element_momentum
from .self_contact import SelfContact
from .smooth_history import SmoothHistory, SmoothRotation
from .springs import RootSpring, Spring
from .strip_air import StripAir
from .tendon import Eyelet, Tendon
from .turbulence import Turbulence
from .values import (
    Along,
    Input,
    Inputs,
    PerElement,
    PerInterval,
    changing,
    first_of,
    inputs_at,
    inputs_of,
    inputs_over,
    value_at,
)
from .viscoelastic import Viscoelastic
from .wind import Gust, Wind, WindField
from .wind_table import WindTable

# fmt: off
__all__ = [
    "ACCELERATION", "ANGULAR_ACCELERATION", "INERTIAL", "POSITION", "ROTATION", "SPIN",
    "VELOCITY", "Accelerogram", "Actuation", "Along", "Box", "Capsule", "Contact", "Cylinder",
    "Damping", "Drag", "Drive", "DynamicStall", "Effect", "Eyelet", "Gravity", "Gust", "History",
    "Induction", "Input", "Inputs", "LineLoad", "Load", "LoadEffect", "LoadPoint", "MassDamping",
    "Obstacle", "PerElement", "PerInterval", "Plane", "PointLoad", "PointMass", "Polar", "Pose",
    "RootSpring", "SelfContact", "SmoothHistory", "SmoothRotation", "Sphere", "Spring",
    "StripAir", "Tendon", "TipLoad", "Turbulence", "Viscoelastic", "Wind", "WindField",
    "WindTable", "blade_element_momentum", "changing",
    "first_of", "inputs_at", "inputs_of", "inputs_over", "rayleigh", "value_at",
]
# fmt: on
