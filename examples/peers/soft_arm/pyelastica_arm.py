"""The torque-driven arm of Elastica-RL-control in PyElastica itself, under the actions of `case`.

Steps are those that are published (position Verlet, seven to an interval), and so are stiffness,
couples and drag: on elements, where torchbeam has them at nodes.
"""

import elastica as ea
import numpy as np
from case import ARM, actions, clock, measured, show
from scipy.interpolate import make_interp_spline


class System(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
    pass


class Torques(ea.NoForces):
    """Couples (3, elements) N m about the sections' own axes: normal, binormal, tangent."""

    def __init__(self, couple):
        self.couple = couple

    def apply_torques(self, system, time=0.0):
        system.external_torques += self.couple


class Drag(ea.NoForces):
    """-c v and -c omega per length."""

    def apply_forces(self, system, time=0.0):
        share = system.lengths / 2
        length = np.concatenate((share, [0.0])) + np.concatenate(([0.0], share))
        system.external_forces -= ARM["viscous"] * length * system.velocity_collection

    def apply_torques(self, system, time=0.0):
        system.external_torques -= ARM["viscous"] * system.lengths * system.omega_collection


def rod():
    n, area = ARM["elements"], np.pi * ARM["radius"] ** 2
    shear = ARM["young"] / 1.5
    made = ea.CosseratRod.straight_rod(
        n,
        start=np.zeros(3),
        direction=np.array([0.0, 1.0, 0.0]),
        normal=np.array([0.0, 0.0, 1.0]),
        base_length=ARM["length"],
        base_radius=ARM["radius"],
        density=ARM["density"],
        youngs_modulus=ARM["young"],
        shear_modulus=shear,
    )
    for k in range(2):
        made.shear_matrix[k, k] = 4 / 3 * shear * area
    return made


def run(kind, seed):
    """Tip (interval, 3) m, at the end of each."""
    system, made, couple = System(), rod(), np.zeros((3, ARM["elements"]))
    system.append(made)
    system.constrain(made).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    system.add_forcing_to(made).using(Torques, couple)
    system.add_forcing_to(made).using(Drag)
    system.finalize()
    verlet, time, tip = ea.PositionVerlet(), np.float64(0.0), []
    knots = np.array([0.0, *ARM["points"], 1.0])
    start = clock()
    for action in actions(kind, seed):
        values = np.pad(action.reshape(2, -1), ((0, 0), (1, 1)))
        places = np.cumsum(made.lengths) / ARM["length"]
        spline = make_interp_spline(knots, values, k=3, axis=1)
        couple[:2] = ARM["torque"] * spline(np.minimum(places, 1.0))
        for _ in range(ARM["substeps"]):
            time = verlet.step(system, time, np.float64(ARM["interval"] / ARM["substeps"]))
        tip.append(made.position_collection[:, -1].copy())
    return np.array(tip), clock() - start


if __name__ == "__main__":
    show(measured("pyelastica", run))
