"""Exudyn's geometrically exact planar beam, quadratic elements, in the common dynamic case;
generalised alpha, undamped.

With --samples: the cost of random samples, each a system of its own that Python builds. 4 elements
have the nodes of 8 linear ones.
"""

import sys

import exudyn as exu
import numpy as np
from case import EA, EI, GA, INERTIA, MASS, clock, measure, sampled, show
from exudyn.utilities import (
    CoordinateConstraint,
    LoadCoordinate,
    MarkerNodeCoordinate,
    NodePointGround,
    NodeRigidBody2D,
    ObjectBeamGeometricallyExact2D,
    SensorNode,
)

# elements, step s
SETTINGS = ((3, 5e-3), (2, 1e-2), (4, 2.5e-3), (6, 1e-3), (8, 1e-3), (12, 5e-4), (16, 2.5e-4))


SAMPLED, TAU = 4, 0.01  # elements; s of damping by strain rates


def build(
    container: exu.SystemContainer,
    elements: int,
    bending: float = EI,
    load: float = 1.0,
    tau: float = 0.0,
) -> tuple:
    """System with bending stiffness, N m^2, transverse tip load, N, and damping by strain rates, s;
    node of the tip.
    """
    system = container.AddSystem()
    nodes = [
        system.AddNode(NodeRigidBody2D(referenceCoordinates=[k / (2 * elements), 0, 0]))
        for k in range(2 * elements + 1)
    ]
    for k in range(elements):
        system.AddObject(
            ObjectBeamGeometricallyExact2D(
                nodeNumbers=nodes[2 * k : 2 * k + 3],
                length=1 / elements,
                massPerLength=MASS,
                crossSectionInertia=INERTIA,
                bendingStiffness=bending,
                axialStiffness=EA,
                shearStiffness=GA,
                bendingDamping=tau * bending,
                axialDamping=tau * EA,
                shearDamping=tau * GA,
            )
        )

    def coordinate(node: int, k: int) -> int:
        return system.AddMarker(MarkerNodeCoordinate(nodeNumber=node, coordinate=k))

    ground = coordinate(system.AddNode(NodePointGround()), 0)
    for k in range(3):
        system.AddObject(CoordinateConstraint(markerNumbers=[ground, coordinate(nodes[0], k)]))
    system.AddLoad(LoadCoordinate(markerNumber=coordinate(nodes[-1], 1), load=load))
    return system, nodes[-1]


def motion(
    system: exu.MainSystem, tip: int, step: float, duration: float, every: float
) -> tuple[np.ndarray, float]:
    """Positions (time, 3) m of the tip, and CPU seconds."""
    sensor = system.AddSensor(
        SensorNode(
            nodeNumber=tip, storeInternal=True, outputVariableType=exu.OutputVariableType.Position
        )
    )
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.timeIntegration.numberOfSteps, settings.timeIntegration.endTime = (
        round(duration / step),
        duration,
    )
    settings.timeIntegration.generalizedAlpha.spectralRadius = 1.0
    settings.timeIntegration.newton.useModifiedNewton = True
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    settings.solution.sensors.writePeriod = every
    start = clock()
    system.SolveDynamic(settings, exu.DynamicSolverType.GeneralizedAlpha)
    return np.array(system.GetSensorStoredData(sensor))[:, 1:], clock() - start


def run(elements: int, step: float) -> tuple[np.ndarray, float]:
    container = exu.SystemContainer()  # holds the system: it has to last as long
    return motion(*build(container, elements), step, 2.0, 0.01)


def static(bending: float, load: float) -> float:
    """Tip deflection, m."""
    container = exu.SystemContainer()
    system, tip = build(container, SAMPLED, bending, load)
    system.Assemble()
    settings = exu.SimulationSettings()
    settings.staticSolver.verboseMode = 0
    settings.solution.file.write = False
    system.SolveStatic(settings)
    return system.GetNodeOutput(tip, exu.OutputVariableType.Position)[1]


def rollout(bending: float, load: float) -> float:
    """Largest tip deflection, m, of 21 instants in 1 s."""
    container = exu.SystemContainer()
    return motion(*build(container, SAMPLED, bending, load, TAU), 0.01, 1.0, 0.05)[0][:, 1].max()


if __name__ == "__main__":
    if "--samples" in sys.argv:
        show(sampled("exudyn", {static: 2000, rollout: 200}))
    else:
        show(measure("exudyn", "plane", "quadratic", SETTINGS, run))
