"""torchbeam: batched, differentiable, geometrically exact beam dynamics in PyTorch."""

from . import plot, sensors
from .advise import Advice, advise
from .beam import Beam
from .critical import Critical, critical_load
from .effects import (
    Accelerogram,
    Actuation,
    Along,
    Damping,
    Drag,
    Gravity,
    History,
    Input,
    LineLoad,
    Load,
    MassDamping,
    PerElement,
    PointLoad,
    PointMass,
    RootSpring,
    Spring,
    TipLoad,
    rayleigh,
)
from .identify import Fit, identify
from .integrate.explicit import ExplicitStepper
from .integrate.simulate import simulate
from .integrate.stepper import Stepper
from .linear import Linear, linearize
from .mixed.block import BlockRate, block_rate
from .mixed.consistent import consistent_state
from .mixed.state import MixedState
from .modes import Modes, modes
from .montecarlo import Samples, monte_carlo
from .paths import Path, path
from .scene import Scene
from .section import Section
from .solution import Energy, Solution, Stats
from .state import State, rest
from .statics import equilibrium
from .stations import Stations, Table
from .supports import Frame, RootMotion, Support

__all__ = [
    "Accelerogram", "Actuation", "Advice", "Along", "Beam", "BlockRate", "Critical", "Damping", "Drag", "Energy",
    "ExplicitStepper", "Fit", "Frame", "Gravity", "History", "Input", "LineLoad", "Linear", "Load", "MassDamping",
    "MixedState", "Modes", "Path", "PerElement", "PointLoad", "PointMass", "RootMotion", "RootSpring", "Samples", "Scene",
    "Section", "Solution", "Spring", "State", "Stations", "Stats", "Stepper", "Support", "Table", "TipLoad", "advise",
    "block_rate", "consistent_state", "critical_load", "equilibrium", "identify", "linearize", "modes", "monte_carlo", "path",
    "plot", "rayleigh", "rest", "sensors", "simulate",
]
