"""SoRoMoX's geometric variable-strain rod in the common dynamic case: one segment whose bending and
torsion are polynomials of the arc length; explicit steps of fifth order (Tsitouras), undamped. With
--beside also a batch by `jax.vmap`, on one thread.

Shear and stretch, which are small here, are no unknowns: they would make explicit steps short.
Compilation is not counted.
"""

import os

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false")

from functools import cache
from itertools import chain

import jax
import jax.numpy as jnp
import numpy as np
from case import EI, GJ, INERTIA, MASS, T, clock, measure, show
from soromox.systems import SystemState
from soromox.systems.components.joints import JointSpec
from soromox.systems.components.links import LinkSpec
from soromox.systems.gvs import GVS, GVSSegment, StrainBasisSpec

jax.config.update("jax_enable_x64", True)

BATCH = 32
SETTINGS = ((3, 5e-3), (4, 2e-3), (2, 1e-2))  # unknowns of each strain, step s
RADIUS = 2 * (INERTIA / MASS) ** 0.5  # m, of the round section with this inertia


def rod(unknowns: int) -> GVS:
    link = LinkSpec.circular(
        length=1.0,
        radius=RADIUS,
        density=MASS / (np.pi * RADIUS**2),
        reference_strain=[0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        young_modulus=EI / (np.pi * RADIUS**4 / 4),
        shear_modulus=GJ / (np.pi * RADIUS**4 / 2),
    )
    basis = StrainBasisSpec("legendre", ("kappa_x", "kappa_y", "kappa_z"), unknowns - 1)
    segment = GVSSegment(link, JointSpec.fixed(), basis, max(5, unknowns + 2))
    pose = jnp.array([0.0, 0, 0, 1, 0, 0, 0])  # along x
    return GVS.from_segments([segment], gravity=jnp.zeros(3), base_pose=pose)


@cache
def motion(unknowns: int, step: float, batch: int):
    """Tips (batch, time, 3) m of loads (batch,) N, compiled."""
    made, tip = rod(unknowns), jnp.array(1.0)
    size = made.num_velocities

    def one(load):
        def pushed(state):
            q, _, _ = made.split_state(state.y)
            return load * made.jacobian(q, tip)[4], None

        states = made.rollout_to(
            SystemState(t=jnp.array(0.0), y=jnp.zeros(2 * size)),
            environment_model=pushed,
            t1=T[-1],
            solver_dt=step,
            save_ts=jnp.asarray(T),
        )
        return jax.vmap(lambda y: made.forward_kinematics(made.split_state(y)[0], tip)[:3, 3])(
            states.y
        )

    return jax.jit(jax.vmap(one)).lower(jnp.ones(batch)).compile()


def run(unknowns: int, step: float, batch: int = 1) -> tuple[np.ndarray, float]:
    """Of the last of a batch."""
    tips, loads = motion(unknowns, step, batch), jnp.ones(batch)
    start = clock()
    tip = tips(loads).block_until_ready()
    return np.asarray(tip[-1]), clock() - start


def run_batch(unknowns: int, step: float) -> tuple[np.ndarray, float]:
    return run(unknowns, step, BATCH)


if __name__ == "__main__":
    show(
        chain(
            measure("soromox", "3D", "polynomials", SETTINGS, run),
            measure("soromox", "3D", "polynomials", SETTINGS, run_batch, BATCH),
        )
    )
