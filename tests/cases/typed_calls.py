"""Public calls as users annotate them: `make lint` checks this file, and it runs as it is."""

import torch
from torch import Tensor

import torchbeam as tb

strip = tb.Section.rectangle(width=0.03, height=0.002, E=69e9, nu=0.33, rho=2700.0)
beam: tb.Beam = tb.Beam.straight(1.0, 4, strip)
scene = tb.Scene(beam, [tb.TipLoad(force=(0, 0, 2.0)), tb.Damping(0.01)])

places: Tensor = scene.beam.nodes
effects: tuple[object, ...] = scene.effects

state: tb.State = tb.equilibrium(scene)
tip: Tensor = state.tip.position
force: Tensor = state.root.force
later: tb.State = state.at(1.0)

solution: tb.Solution = tb.simulate(scene, torch.linspace(0, 0.1, 3), step=0.05)
path: Tensor = solution.tip.position
kinetic: Tensor = solution.energy.kinetic

stepper = tb.Stepper(scene, 0.01)
state = stepper(stepper.rest())
frequency: Tensor = tb.modes(scene, count=2).frequency

arm = tb.Scene(
    {"arm": beam, "hub": tb.Body(0.1, position=(1.0, 0, 0))},
    [tb.PointLoad(("arm", 2), force=(0, 0, 1.0)), tb.PointMass(0.1, node=("arm", -1))],
    joints=tb.Weld(("arm", -1), "hub"),
    supports=tb.Support(("arm", 0)),
)
floor = tb.Contact("arm", tb.Plane((0, 0, -1.0), (0, 0, 1)), thickness=0.01, force=10.0)
touching: tb.Scene = tb.Scene(
    arm.beam, [*arm.effects, floor], joints=arm.joints, supports=arm.supports
)
hub: Tensor = tb.equilibrium(arm)["hub"].position

samples: tb.Samples = tb.monte_carlo(
    lambda EI: 1 / EI, {"EI": tb.laws.LogNormal(1.0, 0.1)}, 64, replicates=16, by_name=True
)
median: Tensor = samples.quantile(0.5)
low: Tensor = samples.quantile(0.5, interval=0.9).low

gauge = tb.sensors.Gauge(0.05, beam, z=0.001)
strain: Tensor = tb.sensors.Stack((tb.sensors.TipPosition(), gauge))(solution.state)
