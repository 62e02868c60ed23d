"""LQR and a Kalman filter from the linearised beam, closed around the full nonlinear one.

A thin strip (EI = 1 N m^2, 0.2 kg/m, 1 m, damping ratio 0.4 % in its first mode) hangs sideways
under a steady tip force of 1 N. `linearize` gives the small motions about that shape, from the tip
force to the tip's measured position across and along; `reduced` keeps six modes, `discrete` holds
the force over 10 ms. From that model come the gains: LQR (`solve_discrete_are`) and the steady
Kalman filter, whose noise also stands for the modes that were left out. The loop is then closed
around `Stepper`: the full geometrically exact beam, released from where 1.5 N across and 0.3 N
sideways had held it; the filter knows noisy tip positions (0.1 mm) alone. The same beam without
control runs beside it, the second sample of one batch. CHECK is the RMS tip error over the last
half second, as a share of that one's. Wants scipy (`pip install torchbeam[control]`).
"""

import numpy as np
import torch
from scipy.linalg import solve_discrete_are

import torchbeam as tb

DT, STEPS, LAST = 0.01, 200, 50
REST, NOISE = np.array([0.0, 1.0, 0.0]), 1e-4  # N, m

section = tb.Section.from_stiffness(EA=4e4, GA=1.48e4, GJ=0.769, EI=1.0, mass=0.2, inertia=5e-6)
scene = tb.Scene(
    tb.Beam.straight(1.0, 8, section), [tb.TipLoad(force=tb.Input("force", 3)), tb.Damping(1e-3)]
)
bent = tb.equilibrium(scene, inputs={"force": torch.as_tensor(REST, dtype=torch.float64)})


def tip(state: tb.State) -> torch.Tensor:
    return state.tip.position


full = tb.linearize(scene, bent, tip, inputs={"force": torch.as_tensor(REST, dtype=torch.float64)})
model = full.reduced(6).discrete(DT)
A, B, C = (X.numpy() for X in (model.A, model.B, model.C))


def gain(A: np.ndarray, B: np.ndarray, Q: np.ndarray, R: np.ndarray) -> np.ndarray:
    """K of u = -K z that minimises the sum of z'Qz + u'Ru."""
    P = solve_discrete_are(A, B, Q, R)
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)


K = gain(A, B, C.T @ C + 1e-9 * np.eye(len(A)), 0.1 * np.eye(3))
L = gain(A.T, C.T, 0.01 * B @ B.T + 1e-9 * np.eye(len(A)), NOISE**2 * np.eye(3)).T  # predictor form


def run() -> tuple[np.ndarray, np.ndarray]:
    """Tip errors (time, 2, 3) m, with and without control, and the control's force (time, 3) N."""
    noise = np.random.default_rng(0)
    stepper = tb.Stepper(scene, DT)
    state = tb.equilibrium(
        scene, inputs={"force": torch.tensor([0.0, 1.5, 0.3], dtype=torch.float64).expand(2, 3)}
    ).at(0.0)
    z, errors, forces = np.zeros(len(A)), [], []
    for _ in range(STEPS):
        error = (tip(state) - tip(bent)).numpy()
        du = -K @ z
        z = A @ z + B @ du + L @ (error[0] + NOISE * noise.standard_normal(3) - C @ z)
        state = stepper(
            state, force=torch.as_tensor(np.stack((REST + du, REST)), dtype=torch.float64)
        )
        errors.append(error)
        forces.append(du)
    return np.array(errors), np.array(forces)


errors, forces = run()
held, free = np.sqrt((errors[-LAST:] ** 2).sum(-1).mean(0))
CHECK = float(held / free)
# what is left of 70 mm and more is the filtered noise and the slowest pole
EXPECTED, TOLERANCE = 0.0, 0.02

poles = np.abs(np.linalg.eigvals(A - B @ K)).max(), np.abs(np.linalg.eigvals(A - L @ C)).max()
print(
    f"{full.A.shape[0]} states reduced to {len(A)}; slowest poles: loop {poles[0]:.3f}, filter "
    f"{poles[1]:.3f} a step"
)
print(
    f"tip error, rms over the last {LAST * DT:g} s: {1e3 * free:.2f} mm free, {1e3 * held:.2f} mm "
    f"controlled ({100 * CHECK:.1f} %); largest control force {np.abs(forces).max():.2f} N"
)
