"""Exudyn's geometrically exact planar beam, quadratic elements, in the common dynamic case; generalised alpha, undamped."""

import exudyn as exu
import numpy as np
from case import EA, EI, GA, INERTIA, MASS, clock, measure, show
from exudyn.utilities import (
    CoordinateConstraint,
    LoadCoordinate,
    MarkerNodeCoordinate,
    NodePointGround,
    NodeRigidBody2D,
    ObjectBeamGeometricallyExact2D,
    SensorNode,
)

SETTINGS = ((3, 5e-3), (2, 1e-2), (4, 2.5e-3), (6, 1e-3), (8, 1e-3), (12, 5e-4), (16, 2.5e-4))  # elements, step s


def run(elements: int, step: float) -> tuple[np.ndarray, float]:
    container = exu.SystemContainer()  # holds the system: it has to last as long
    system = container.AddSystem()
    nodes = [system.AddNode(NodeRigidBody2D(referenceCoordinates=[k / (2 * elements), 0, 0])) for k in range(2 * elements + 1)]
    for k in range(elements):
        system.AddObject(ObjectBeamGeometricallyExact2D(
            nodeNumbers=nodes[2 * k:2 * k + 3], length=1 / elements, massPerLength=MASS, crossSectionInertia=INERTIA,
            bendingStiffness=EI, axialStiffness=EA, shearStiffness=GA))

    def coordinate(node: int, k: int) -> int:
        return system.AddMarker(MarkerNodeCoordinate(nodeNumber=node, coordinate=k))

    ground = coordinate(system.AddNode(NodePointGround()), 0)
    for k in range(3):
        system.AddObject(CoordinateConstraint(markerNumbers=[ground, coordinate(nodes[0], k)]))
    system.AddLoad(LoadCoordinate(markerNumber=coordinate(nodes[-1], 1), load=1.0))
    tip = system.AddSensor(SensorNode(nodeNumber=nodes[-1], storeInternal=True,
                                      outputVariableType=exu.OutputVariableType.Position))
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = round(2 / step), 2.0
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = 0.01
    start = clock()
    system.SolveDynamic(settings, exu.DynamicSolverType.GeneralizedAlpha)
    return np.array(system.GetSensorStoredData(tip))[:, 1:], clock() - start


if __name__ == "__main__":
    show(measure("exudyn", "plane", "quadratic", SETTINGS, run))
