"""torchbeam: batched, differentiable, geometrically exact beam dynamics in PyTorch.

Examples in docstrings go on from these lines:

>>> import torch
>>> import torchbeam as tb
>>> strip = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
>>> beam = tb.Beam.straight(1.0, 4, strip)
>>> scene = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0)), tb.Damping(0.01)])
>>> solution = tb.simulate(scene, torch.linspace(0, 0.1, 6), step=0.01)
>>> laws = {"EI": tb.laws.LogNormal(1.0, 0.1), "P": tb.laws.Normal(1.0, 0.1)}
>>> deflection = lambda EI, P: P / (3 * EI)
"""

import os
from typing import TYPE_CHECKING, Any

import torch

from . import plot, sensors
from .analysis.advise import Advice, advise
from .analysis.campbell import campbell
from .analysis.campbell_diagram import Campbell
from .analysis.convergence.converge import converge
from .analysis.convergence.convergence import Convergence
from .analysis.convergence.on_request import (
    critical_load,
    equilibrium,
    linearize,
    modes,
    path,
    rest,
    simulate,
)
from .analysis.convergence.remesh import remesh
from .analysis.describe import Description, describe
from .analysis.estimation.filtered import Filtered
from .analysis.estimation.kalman_filter import KalmanFilter
from .analysis.estimation.moving_horizon import MovingHorizon
from .analysis.export import export
from .analysis.identification.bootstrap import Bootstrap
from .analysis.identification.comparison import Comparison, compare
from .analysis.identification.design import design
from .analysis.identification.design_result import Design
from .analysis.identification.fields import FieldFit, identify_fields
from .analysis.identification.fit import Fit
from .analysis.identification.identify import identify
from .analysis.identification.measurement import Measurement
from .analysis.identification.parameter import Parameter
from .analysis.identification.prediction import Prediction
from .analysis.identification.profile import Profile
from .analysis.identification.slow_baseline import SlowBaseline
from .analysis.identification.smoothness import Smoothness
from .analysis.identification.transform import Transform
from .analysis.saved import load, save
from .analysis.unbalance_response import unbalance_response
from .core.entry_point import entry_points
from .core.missing_name import ELSEWHERE, missing
from .core.results import versions
from .core.warning import SlowPathWarning
from .dynamics.explicit import ExplicitStepper
from .dynamics.forms import mixed_forms
from .dynamics.rollout import rollout
from .dynamics.rollout_jacobian import rollout_jacobian
from .dynamics.stepper import Stepper
from .linear.critical import Critical
from .linear.linear_model import Linear
from .linear.mode_pairing import PairedModes, modal_assurance, pair_modes
from .linear.modes import Modes
from .plot.notebook import in_html
from .plot.view import View, view
from .readers.read import read
from .scene.ball import Ball
from .scene.beam import Beam
from .scene.body import Body
from .scene.bouc_wen import BoucWen
from .scene.effects import (
    Accelerogram,
    Actuation,
    Along,
    Box,
    Capsule,
    Contact,
    Cylinder,
    Damping,
    Drag,
    Drive,
    DynamicStall,
    Gravity,
    Gust,
    History,
    Induction,
    Input,
    LineLoad,
    Load,
    MassDamping,
    PerElement,
    PerInterval,
    Plane,
    PointLoad,
    PointMass,
    Polar,
    RootSpring,
    SelfContact,
    SmoothHistory,
    SmoothRotation,
    Sphere,
    Spring,
    StripAir,
    Tendon,
    TipLoad,
    Turbulence,
    Viscoelastic,
    Wind,
    WindTable,
    blade_element_momentum,
    rayleigh,
)
from .scene.elasto_plastic import ElastoPlastic
from .scene.joints import Cylindrical, Distance, Hinge, Slider, Universal, Weld
from .scene.scene import Scene
from .scene.section import Section
from .scene.stations import Stations, Table
from .scene.supports import Frame, RootMotion, Support
from .sensors.observe import observe
from .sensors.pose import Pose, pose_from_points
from .sensors.sensor_frame import SensorFrame
from .state.instant import Instant
from .state.solution import Energy, Solution, Stats
from .state.state import State
from .statics.path import Path
from .uncertainty import laws
from .uncertainty.estimate import Estimate
from .uncertainty.moment_derivatives import MomentDerivatives, moment_derivatives
from .uncertainty.monte_carlo import monte_carlo
from .uncertainty.monte_carlo_stream import monte_carlo_stream
from .uncertainty.rare_event import RareEvent, rare_event
from .uncertainty.samples import Samples
from .uncertainty.sobol_indices import SobolIndices, sobol_indices
from .uncertainty.stream import Stream
from .uncertainty.tornado import Tornado, tornado

if TYPE_CHECKING:  # imported where they are first asked for
    from .cross_section.public import CrossSection, Material
    from .mixed import BlockRate, MixedState, block_rate, consistent_state

# fmt: off
__all__ = [
    "Accelerogram", "Actuation", "Advice", "Along", "Ball", "Beam", "BlockRate", "Body",
    "BoucWen", "Box", "Campbell", "Capsule", "Comparison", "Contact", "Convergence", "Critical",
    "CrossSection", "Cylinder", "Cylindrical", "Damping", "Description", "Design", "Distance",
    "Drag", "Drive", "DynamicStall", "ElastoPlastic", "Energy", "Estimate", "ExplicitStepper",
    "FieldFit", "Filtered", "Fit", "Frame", "Gravity", "Gust", "Hinge", "History", "Induction",
    "Input", "KalmanFilter", "LineLoad", "Linear", "Load", "MassDamping", "Material",
    "Measurement", "MixedState", "Modes", "MomentDerivatives", "MovingHorizon", "PairedModes",
    "Parameter", "Path", "PerElement", "PerInterval", "Plane", "PointLoad", "PointMass", "Polar",
    "Pose", "RareEvent", "RootMotion", "RootSpring", "Samples", "Scene", "Section", "SelfContact",
    "SensorFrame", "Slider", "SlowBaseline", "SlowPathWarning", "SmoothHistory", "SmoothRotation",
    "Smoothness", "SobolIndices", "Solution", "Sphere", "Spring", "State", "Stations", "Stats",
    "Stepper", "Stream", "StripAir", "Support", "Table", "Tendon", "TipLoad", "Tornado",
    "Turbulence", "Universal", "View", "Viscoelastic", "Weld", "Wind", "WindTable", "advise",
    "blade_element_momentum", "block_rate", "campbell", "compare", "consistent_state", "converge",
    "critical_load", "describe", "design", "equilibrium", "export", "identify", "identify_fields",
    "laws", "linearize", "load", "modal_assurance", "modes", "moment_derivatives", "monte_carlo",
    "monte_carlo_stream", "observe", "pair_modes", "path", "plot", "pose_from_points",
    "rare_event", "rayleigh", "read", "remesh", "rest", "rollout", "rollout_jacobian", "save",
    "sensors", "simulate", "sobol_indices", "tornado", "unbalance_response",
    "view",
]
# fmt: on

# results that hold tensors and plain values alone: torch.load(weights_only=True) takes them
torch.serialization.add_safe_globals(
    [
        Advice,
        Bootstrap,
        Campbell,
        Critical,
        Description,
        Estimate,
        Modes,
        MomentDerivatives,
        PairedModes,
        Path,
        Prediction,
        Profile,
        RareEvent,
        SobolIndices,
        Tornado,
        Transform,
        *(getattr(laws, name) for name in laws.__all__),
        slice,
    ]
)

if hasattr(os, "register_at_fork"):
    # threads of OpenMP do not live on in a fork: an operation that counts on them waits for ever
    os.register_at_fork(after_in_child=lambda: torch.set_num_threads(1))

for shown in (Scene, Solution, Instant, Modes):  # in notebooks
    shown._repr_html_ = in_html  # type: ignore[attr-defined]

entry_points(globals(), __all__)


def __getattr__(name: str) -> Any:
    """Public names that are imported where they are asked for: of sections from geometry, of the
    derivation's element, see `dynamics.forms`, and the version.
    """
    if name == "__version__":
        return versions("torchbeam")["torchbeam"]
    if name not in __all__:
        raise missing(f"module {__name__!r}", name, __all__, ELSEWHERE)
    if name in ("CrossSection", "Material"):
        from .cross_section import public as package
    else:
        package = mixed_forms()
    globals()[name] = getattr(package, name)
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
