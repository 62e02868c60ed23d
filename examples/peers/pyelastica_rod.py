"""PyElastica's Cosserat rod in the common dynamic case: explicit (position Verlet), undamped.

The rod is made round and then given the stiffness and inertia of the case. The first element, whose
directors are held, does not bend: so the rod begins half an element before the clamp, where the
bending of the first vertex ends. Steps are near the longest stable ones, which the rotary inertia
sets: sections turn against shear at 54,000 rad/s. Longer steps are given as much more of it as
makes them stable, which costs less accuracy than the mesh.
"""

import elastica as ea
import numpy as np
from case import EA, EI, GA, GJ, INERTIA, MASS, clock, measure, show

# elements, step s
SETTINGS = ((20, 1e-4), (10, 2e-4), (14, 1e-4), (28, 5e-5), (40, 5e-5), (56, 2.5e-5))
STABLE = 2.5e-5  # s, of the case's own rotary inertia
RADIUS = 0.01  # m, of the round rod that is made first
EVERY = 0.01  # s


class System(ea.BaseSystemCollection, ea.Constraints, ea.Forcing):
    pass


def rod(elements: int, step: float) -> ea.CosseratRod:
    rotary = INERTIA * max(1.0, step / STABLE) ** 2
    h = 1 / (elements - 0.5)
    made = ea.CosseratRod.straight_rod(
        elements,
        start=np.array([-h / 2, 0, 0]),
        direction=np.array([1.0, 0, 0]),
        normal=np.array([0, 0, 1.0]),
        base_length=elements * h,
        base_radius=RADIUS,
        density=MASS / (np.pi * RADIUS**2),
        youngs_modulus=1e6,
        shear_modulus=1e6 / 3,
    )
    for k, (shear, bend, inertia) in enumerate(
        ((GA, EI, rotary), (GA, EI, rotary), (EA, GJ, 2 * rotary))
    ):
        made.shear_matrix[k, k], made.bend_matrix[k, k] = shear, bend
        made.mass_second_moment_of_inertia[k, k] = inertia * h
        made.inv_mass_second_moment_of_inertia[k, k] = 1 / (inertia * h)
    return made


def run(elements: int, step: float) -> tuple[np.ndarray, float]:
    system, made = System(), rod(elements, step)
    system.append(made)
    system.constrain(made).using(
        ea.OneEndFixedBC, constrained_position_idx=(0,), constrained_director_idx=(0,)
    )
    system.add_forcing_to(made).using(
        ea.EndpointForces, np.zeros(3), np.array([0, 1.0, 0]), ramp_up_time=1e-9
    )
    system.finalize()
    verlet = ea.PositionVerlet()
    way, time = [made.position_collection[:, -1].copy()], np.float64(0.0)
    start = clock()
    for _ in range(200):
        for _ in range(round(EVERY / step)):
            time = verlet.step(system, time, step)
        way.append(made.position_collection[:, -1].copy())
    return np.array(way), clock() - start


if __name__ == "__main__":
    show(measure("pyelastica", "3D", "rod", SETTINGS, run))
