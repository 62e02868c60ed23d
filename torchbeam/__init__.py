"""torchbeam: batched, differentiable, geometrically exact beam dynamics in PyTorch."""

from . import plot, sensors
from .analysis.advise import Advice, advise
from .analysis.describe import Description, describe
from .analysis.identification.fields import FieldFit, identify_fields
from .analysis.identification.fit import Fit
from .analysis.identification.identify import identify
from .analysis.identification.measurement import Measurement
from .analysis.identification.parameter import Parameter
from .analysis.identification.smoothness import Smoothness
from .analysis.monte_carlo import Samples, monte_carlo
from .dynamics.explicit import ExplicitStepper
from .dynamics.rollout import rollout
from .dynamics.simulate import simulate
from .dynamics.stepper import Stepper
from .linear.critical import Critical, critical_load
from .linear.linear_model import Linear
from .linear.mode_pairing import PairedModes, modal_assurance, pair_modes
from .linear.modes import Modes, modes
from .linear.state_space import linearize
from .mixed.block import BlockRate, block_rate
from .mixed.consistent import consistent_state
from .mixed.state import MixedState
from .scene.beam import Beam
from .scene.effects import (
    Accelerogram,
    Actuation,
    Along,
    Damping,
    Drag,
    Gravity,
    History,
    Input,
    LineLoad,
    MassDamping,
    PerElement,
    PerInterval,
    PointLoad,
    PointMass,
    RootSpring,
    Spring,
    TipLoad,
    rayleigh,
)
from .scene.effects import (
    CustomLoad as Load,
)
from .scene.scene import Scene
from .scene.section import Section
from .scene.stations import Stations, Table
from .scene.supports import Frame, RootMotion, Support
from .sensors.observe import observe
from .state.solution import Energy, Solution, Stats
from .state.state import State, rest
from .statics.equilibrium import equilibrium
from .statics.path import Path, path

__all__ = [
    "Accelerogram", "Actuation", "Advice", "Along", "Beam", "BlockRate", "Critical", "Damping", "Description", "Drag",
    "Energy", "ExplicitStepper", "FieldFit", "Fit", "Frame", "Gravity", "History", "Input", "LineLoad", "Linear", "Load",
    "MassDamping", "Measurement", "MixedState", "Modes", "PairedModes", "Parameter", "Path", "PerElement", "PerInterval",
    "PointLoad", "PointMass", "RootMotion", "RootSpring", "Samples", "Scene", "Section", "Smoothness", "Solution", "Spring",
    "State", "Stations", "Stats", "Stepper", "Support", "Table", "TipLoad", "advise", "block_rate", "consistent_state",
    "critical_load", "describe", "equilibrium", "identify", "identify_fields", "linearize", "modal_assurance", "modes",
    "monte_carlo", "observe", "pair_modes", "path", "plot", "rayleigh", "rest", "rollout", "sensors", "simulate",
]
