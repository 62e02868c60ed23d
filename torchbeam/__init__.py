"""torchbeam: batched, differentiable, geometrically exact beam dynamics in PyTorch."""

from .beam import Beam
from .effects import Damping, Gravity, Input, LineLoad, PointLoad, TipLoad
from .integrate.simulate import simulate
from .integrate.stepper import Stepper
from .scene import Frame, RootMotion, Scene
from .section import Section
from .solution import Energy, Solution, Stats
from .state import State, rest
from .statics import equilibrium

__all__ = [
    "Beam", "Damping", "Energy", "Frame", "Gravity", "Input", "LineLoad", "PointLoad", "RootMotion", "Scene", "Section",
    "Solution", "State", "Stats", "Stepper", "TipLoad", "equilibrium", "rest", "simulate",
]
