"""Sensors: readings of a beam's state. One kind of object for environments, identification,
linearisation and plots.

    tip = tb.sensors.TipPosition(reference=start)     tip(state) -> (..., 3) m
    tip(solution.state) -> (time, ..., 3)
    tip["z"] or tip[2]                                one component: (..., 1)
    tb.sensors.Stack((tip, tb.sensors.Spin(-1)))      several as one vector: (..., 6)

A sensor is called with a state of any form (`State`, `MixedState`), batched, or a trajectory
(time first), and returns a tensor with the same leading axes; it is differentiable in the state and
in what it was made of. Each has

    name    what it reads        unit    SI        labels  one short name for each number
    shape   of a reading, (3,) for a vector         size    numbers in it
"""

from ..core.entry_point import entry_points
from ..core.missing_name import by_word, near_names
from .acceleration import NodeAcceleration
from .along import Curvature, Gauge, Strain, Stress
from .contact import (
    ContactForce,
    ContactForces,
    ContactGap,
    ContactPoints,
    ContactPressure,
    ContactSlip,
)
from .interactions import (
    JointCoordinate,
    JointHysteresis,
    JointLoad,
    JointRate,
    TendonLength,
    TendonTension,
)
from .node import Angles, NodePosition, NodeRotation, NodeVelocity, Spin, TipPosition, TipVelocity
from .position import Position
from .root import Reaction, RootForce, RootMoment, RootReaction, RootSpringLoad
from .section_forces import SectionForces
from .sensor import Component, Sensor, Stack

# fmt: off
__all__ = [
    "Angles", "Component", "ContactForce", "ContactForces", "ContactGap", "ContactPoints",
    "ContactPressure",
    "ContactSlip", "Curvature", "Gauge", "JointCoordinate", "JointHysteresis",
    "JointLoad", "JointRate",
    "NodeAcceleration", "NodePosition", "NodeRotation", "NodeVelocity", "Position",
    "Reaction", "RootForce", "RootMoment", "RootReaction", "RootSpringLoad", "SectionForces",
    "Sensor", "Spin", "Stack", "Strain", "Stress", "TendonLength", "TendonTension",
    "TipPosition", "TipVelocity",
]
# fmt: on

entry_points(globals(), __all__)

# what others call so
ELSEWHERE = by_word(
    {
        "Gauge": "straingauge",
        "JointCoordinate": "encoder",
        "NodeAcceleration": "accelerometer",
        "NodePosition": "displacement",
        "Position": "laser marker",
        "RootReaction": "loadcell",
        "SectionForces": "moment",
        "Spin": "gyro gyroscope",
    }
)
near_names(globals(), ELSEWHERE)
