"""DiSMech-Newton's discrete elastic rod in the common dynamic case, on the CPU in single precision:
implicit midpoint steps (`theta=0.5`), Gauss-Newton iterations on the energy of a step (`exact`).

The first edge is held, which is a clamp of first order. So the rod begins half an edge before the
clamp: the edge's middle, where the bending of the first free node ends, is where the beam is held.
"""

import warp as wp
from warp._src.codegen import Struct

if "__or__" not in vars(Struct):  # 0.1.0.post4 says `Slots | None`, which warp's structs refuse
    Struct.__or__ = lambda self, other: object

import newton
import numpy as np
from case import EA, EI, GA, GJ, INERTIA, MASS, clock, measure, show
from dismech_newton import DiSMechSolver, add_rod, fix_segment

SETTINGS = ((14, 5e-3), (8, 1e-2), (20, 5e-3), (28, 2.5e-3))  # edges, step s
RADIUS = 2 * (INERTIA / MASS) ** 0.5  # m, of the round section with this inertia
ITERATIONS = 2


def run(edges: int, step: float) -> tuple[np.ndarray, float]:
    h = 1 / (edges - 0.5)
    points = np.zeros((edges + 1, 3))
    points[:, 0] = h * (np.arange(edges + 1) - 0.5)
    builder = newton.ModelBuilder(gravity=(0.0, 0.0, 0.0))
    DiSMechSolver.register_custom_attributes(builder)
    shape = newton.ModelBuilder.ShapeConfig(density=MASS / (np.pi * RADIUS**2))
    rod = newton.Rod(
        points,
        radius=RADIUS,
        stretch_rigidity=EA,
        shear_rigidity=GA,
        bend_rigidity=EI,
        twist_rigidity=GJ,
    )
    first, *_ = add_rod(builder, rod, cfg=shape, proxies=False)
    fix_segment(builder, edge=first)
    model = builder.finalize(device="cpu")
    solver = DiSMechSolver(
        model, iterations=ITERATIONS, exact=True, theta=0.5, self_contact=False, linesearch=1
    )
    now, then = model.state(), model.state()
    force = np.zeros((edges + 1, 3), dtype=np.float32)
    force[-1, 1] = 1.0
    for state in (now, then):
        state.particle_f.assign(force)
    way = [now.particle_q.numpy()[-1].copy()]
    start = clock()
    for _ in range(200):
        for _ in range(round(0.01 / step)):
            solver.step(now, then, None, None, step)
            now, then = then, now
        way.append(now.particle_q.numpy()[-1].copy())
    return np.array(way, dtype=float), clock() - start


if __name__ == "__main__":
    wp.config.quiet = True
    show(measure("dismech-newton", "3D", "rod", SETTINGS, run))
