"""Exudyn's geometrically exact beams and joints by multipliers in the two mechanisms; generalised
alpha. In the plane its elements are quadratic, in space linear.
"""

from itertools import pairwise

import exudyn as exu
import numpy as np
from case import (
    DAMPING,
    DURATION,
    EA,
    EI,
    EVERY,
    FINGERS,
    GA,
    GRAVITY,
    INERTIA,
    KNUCKLE,
    MASS,
    PALM,
    PINS,
    clock,
    finger,
    measured,
    show,
)
from exudyn.utilities import (
    LoadMassProportional,
    MarkerBodyMass,
    MarkerBodyPosition,
    MarkerBodyRigid,
    MarkerNodePosition,
    MarkerNodeRigid,
    NodeRigidBody2D,
    NodeRigidBodyEP,
    ObjectBeamGeometricallyExact,
    ObjectBeamGeometricallyExact2D,
    ObjectConnectorTorsionalSpringDamper,
    ObjectGround,
    ObjectJointGeneric,
    ObjectJointRevolute2D,
    ObjectRigidBody,
    RotationMatrix2EulerParameters,
    SensorNode,
    Torque,
)

ABOUT_Z = [1, 1, 1, 1, 1, 0]  # what a hinge about the local z axis holds
# quadratic elements have twice the nodes
LINKAGE = (3, 1e-2), (2, 2e-2), (2, 1e-2), (4, 5e-3), (6, 2.5e-3), (8, 1e-3)
HAND = (4, 1e-2), (3, 2e-2), (6, 5e-3), (8, 2.5e-3), (16, 1e-3)


def linkage(elements: int, step: float) -> tuple[np.ndarray, float]:
    """Pins of the first and second bar."""
    container = exu.SystemContainer()  # holds the system: it has to last as long
    system = container.AddSystem()
    ends = []
    for root, end in pairwise(PINS):
        along, length = end - root, np.linalg.norm(end - root)
        angle = np.arctan2(along[1], along[0])
        nodes = [
            system.AddNode(NodeRigidBody2D(referenceCoordinates=[*(root + s * along)[:2], angle]))
            for s in np.linspace(0, 1, 2 * elements + 1)
        ]
        for k in range(elements):
            stiffness = (
                dict(bendingStiffness=EI, axialStiffness=EA, shearStiffness=GA)
                | dict(bendingDamping=DAMPING * EI, axialDamping=DAMPING * EA)
                | dict(shearDamping=DAMPING * GA)
            )
            body = system.AddObject(
                ObjectBeamGeometricallyExact2D(
                    nodeNumbers=nodes[2 * k : 2 * k + 3],
                    length=length / elements,
                    massPerLength=MASS,
                    crossSectionInertia=INERTIA,
                    **stiffness,
                )
            )
            weigh(system, body, (0, -GRAVITY, 0))
        ends.append((nodes[0], nodes[-1]))
    ground = system.AddObject(ObjectGround())
    pins = [[system.AddMarker(MarkerNodePosition(nodeNumber=n)) for n in pair] for pair in ends]
    fixed = [
        system.AddMarker(MarkerBodyPosition(bodyNumber=ground, localPosition=PINS[k]))
        for k in (0, -1)
    ]
    order = [fixed[0], *pins[0], *pins[1], *pins[2], fixed[1]]
    for pair in zip(order[::2], order[1::2], strict=True):
        system.AddObject(ObjectJointRevolute2D(markerNumbers=list(pair)))
    return motion(system, [ends[0][1], ends[1][1]], step)


def hand(elements: int, step: float) -> tuple[np.ndarray, float]:
    """Tips of the fingers."""
    container = exu.SystemContainer()
    system = container.AddSystem()
    section, polar = exu.BeamSection(), 2 * INERTIA
    section.stiffnessMatrix = np.diag([EA, GA, GA, EI, EI, EI])
    section.massPerLength, section.inertia = MASS, np.diag([polar, INERTIA, INERTIA])
    node = system.AddNode(NodeRigidBodyEP(referenceCoordinates=[0, 0, 0, 1, 0, 0, 0]))
    palm = system.AddObject(
        ObjectRigidBody(mass=PALM["mass"], inertia=[PALM["inertia"]] * 3 + [0] * 3, nodeNumber=node)
    )
    weigh(system, palm, (0, 0, -GRAVITY))
    centre = system.AddMarker(MarkerNodeRigid(nodeNumber=node))
    system.AddLoad(Torque(markerNumber=centre, loadVector=[0, PALM["torque"], 0]))
    ground = system.AddObject(ObjectGround())
    turned = exu.HT(rotation=[[1, 0, 0], [0, 0, 1], [0, -1, 0]], translation=[0, 0, 0])  # z to y
    markers = [
        system.AddMarker(MarkerBodyRigid(bodyNumber=body, localHT=turned))
        for body in (ground, palm)
    ]
    system.AddObject(ObjectJointGeneric(markerNumbers=markers, constrainedAxes=ABOUT_Z))
    tips = []
    for k in range(FINGERS["count"]):
        places, along, axis = finger(k)
        axes = np.stack((along, np.cross(axis, along), axis), -1)
        quaternion = list(RotationMatrix2EulerParameters(axes))
        last = system.AddMarker(
            MarkerBodyRigid(bodyNumber=palm, localHT=exu.HT(rotation=axes, translation=places[0]))
        )
        for root, end, joint in zip(places[:2], places[1:], ([1] * 6, ABOUT_Z), strict=True):
            nodes = [
                system.AddNode(
                    NodeRigidBodyEP(referenceCoordinates=[*(root + s * (end - root)), *quaternion])
                )
                for s in np.linspace(0, 1, elements + 1)
            ]
            for pair in pairwise(nodes):
                body = system.AddObject(
                    ObjectBeamGeometricallyExact(
                        nodeNumbers=list(pair),
                        length=FINGERS["phalanx"] / elements,
                        sectionData=section,
                    )
                )
                weigh(system, body, (0, 0, -GRAVITY))
            pair = [last, system.AddMarker(MarkerNodeRigid(nodeNumber=nodes[0]))]
            system.AddObject(ObjectJointGeneric(markerNumbers=pair, constrainedAxes=joint))
            if joint == ABOUT_Z:
                system.AddObject(
                    ObjectConnectorTorsionalSpringDamper(markerNumbers=pair, **KNUCKLE)
                )
            last = system.AddMarker(MarkerNodeRigid(nodeNumber=nodes[-1]))
        tips.append(nodes[-1])
    return motion(system, tips, step)


def weigh(system: exu.MainSystem, body: int, gravity: tuple[float, float, float]) -> None:
    marker = system.AddMarker(MarkerBodyMass(bodyNumber=body))
    system.AddLoad(LoadMassProportional(markerNumber=marker, loadVector=gravity))


def motion(system: exu.MainSystem, nodes: list[int], step: float) -> tuple[np.ndarray, float]:
    """Positions (time, node, 3) m at all instants, or at each step if these are longer; CPU
    seconds.
    """
    position = exu.OutputVariableType.Position
    sensors = [
        system.AddSensor(SensorNode(nodeNumber=n, storeInternal=True, outputVariableType=position))
        for n in nodes
    ]
    system.Assemble()
    settings = exu.SimulationSettings()
    time = settings.timeIntegration
    time.numberOfSteps, time.endTime, time.verboseMode = round(DURATION / step), DURATION, 0
    time.generalizedAlpha.spectralRadius = 0.9
    time.newton.useModifiedNewton = True
    settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = max(step, EVERY)
    start = clock()
    system.SolveDynamic(settings, exu.DynamicSolverType.GeneralizedAlpha)
    seconds = clock() - start
    found = np.stack([np.array(system.GetSensorStoredData(s)) for s in sensors], 1)
    return found[..., 1:], seconds


if __name__ == "__main__":
    show(measured("exudyn", "exact", {"four-bar": (linkage, LINKAGE), "hand": (hand, HAND)}))
