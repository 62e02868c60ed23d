"""torchbeam.extend: for those who write effects, sensors, environments and commands of their own.

Trees of tensors  `Tree`, a dataclass whose tensors are declared by `leaf`, with what they must
                  be, from which checks, batches, gradients, devices, save and load follow;
                  `Value` annotates what may be a tensor or numbers; `leaves`, `own_leaves`,
                  `map_leaves`, `with_values`, `detached`; `BatchSubset`: samples taken from a
                  batch and put back; `broadcast_shapes`, torch's without what its first call
                  imports
Effects           `LoadEffect`, the base of a load that `torchbeam.Load` cannot say; `LoadPoint`,
                  where it acts; `Interaction`, the base of what acts between several nodes; what
                  both may depend on: `POSITION`, `ROTATION`, `VELOCITY`, `SPIN`,
                  `ACCELERATION`, `ANGULAR_ACCELERATION`; `parameter`, a number that may not be
                  negative; `Obstacle`, the base of a body that a beam may touch, by its signed
                  distance; `WindField`, the base of a wind; `inputs_of`, the inputs that a tree
                  waits for; `trace` tries whether a function is one for native code,
                  `NotTraceable` says why not
Arguments         `choice` and `count` refuse what is none; `shown` writes a value into a sentence;
                  `METHODS`, `ODE_METHODS`, `FORMS`, `ENGINES`: what `torchbeam.simulate` takes
Rotations         `quaternions`, functions of unit quaternions (..., 4), real part first
Warnings          `warn` points to the user's line
Threads           `one_thread`: operations of few numbers are not divided among torch's threads
Public names      `entry_points`: what users call, left alone by torch.autocast and torch.compile

A sensor is derived from `torchbeam.sensors.Sensor`; commands are in `torchbeam.extend.commands`.
How each is used: docs/architecture.md.

Examples in docstrings go on from these lines:

>>> from dataclasses import dataclass
>>> import torch
>>> import torchbeam as tb
>>> from torchbeam import extend
"""

from ..core.arguments import choice, count
from ..core.batch_subset import BatchSubset
from ..core.declared import parameter
from ..core.entry_point import entry_point, entry_points
from ..core.leaves import Tree, detached, leaf, leaves, map_leaves, own_leaves, with_values
from ..core.one_thread import one_thread
from ..core.validation import Value, shown
from ..core.warning import warn
from ..dynamics.forms import FORMS
from ..dynamics.methods import METHODS
from ..dynamics.torchdiffeq_bridge import METHODS as ODE_METHODS
from ..engine.chain.coverage import ENGINES
from ..engine.compiler.trace import NotTraceable, trace
from ..math import quaternions
from ..math.shapes import broadcast_shapes
from ..scene.effects import (
    ACCELERATION,
    ANGULAR_ACCELERATION,
    POSITION,
    ROTATION,
    SPIN,
    VELOCITY,
    LoadEffect,
    LoadPoint,
    Obstacle,
    WindField,
    inputs_of,
)
from ..scene.effects.interaction import Interaction

# fmt: off
__all__ = [
    "ACCELERATION", "ANGULAR_ACCELERATION", "ENGINES", "FORMS", "METHODS", "ODE_METHODS",
    "POSITION",
    "ROTATION", "SPIN", "VELOCITY", "BatchSubset", "Interaction", "LoadEffect", "LoadPoint",
    "NotTraceable", "Obstacle", "Tree",
    "Value", "WindField", "broadcast_shapes", "choice", "count", "detached", "entry_point",
    "entry_points",
    "inputs_of", "leaf", "leaves", "map_leaves", "one_thread", "own_leaves", "parameter",
    "quaternions", "shown", "trace", "warn", "with_values",
]
# fmt: on
