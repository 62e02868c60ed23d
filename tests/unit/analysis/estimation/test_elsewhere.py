"""The filter of a linear structure is python-control's."""

import numpy as np
import pytest
import torch

import torchbeam as tb

from .test_kalman_filter import DT, TIP, randn, up

PROCESS, NOISE = 300.0, 0.01  # N, m


@pytest.mark.steps
def test_python_control_expects_the_same():
    """Means and covariances of z an interval ahead, by their deviations, to 1e-10.

    The plant there is the model's, sampled by the trapezoidal rule, which a midpoint step of linear
    motion is; nothing of the filter's own derivatives. A step knows a node's place to a rounding of
    the beam's length, of which the stiffness in shear makes a force. So the bar is no thin strip,
    and its motion no smaller than a tenth of its length. Of a strip (L/h = 500) that moves by
    millimetres means agree to 1e-10 over thirty readings alone, covariances to 5e-12.
    """
    control = pytest.importorskip("control")
    section = tb.Section.rectangle(width=0.03, height=0.02, E=69e9, nu=0.33, rho=2700.0)
    loads = [tb.TipLoad(force=tb.Input("u", 3)), tb.Damping(1e-3)]
    scene, count = tb.Scene(tb.Beam.straight(1.0, 2, section), loads, small=True), 20
    f = tb.KalmanFilter(scene, TIP, dt=DT, noise=NOISE, process={"u": up(PROCESS)})
    model = tb.linearize(scene, outputs=TIP, inputs={"u": up(0.0)}).to_control()
    # forces are held over a step; C is the model's, as z is that of an instant
    held = control.sample_system(model, DT, method="bilinear")
    A, G = held.A, held.B[:, 2:] * PROCESS
    start, y, n = f.start(amplitude=0.1), 0.1 * randn(count, 1), f.moves
    first = A @ start.covariance.numpy() @ A.T + G @ G.T
    first = (first + first.T) / 2
    other = control.create_estimator_iosystem(
        control.ss(A, G, model.C, 0.0, True), np.eye(1), NOISE**2 * np.eye(1), P0=first
    )
    inputs = [y[:, 0].numpy(), np.zeros(count)]
    response = control.input_output_response(
        other, np.arange(count), inputs, X0=[np.zeros(n), first]
    )
    expected = torch.from_numpy(np.array(response.states)).mT[1:]
    for now, theirs in zip(f.run(start, y[:-1]), expected, strict=True):
        ahead, x, P = f(now), theirs[:n], theirs[n:].unflatten(-1, (n, n))
        scale = P.diagonal().sqrt().clamp(min=1e-5)  # of what nothing moves
        assert ((ahead.x - x) / scale).abs().max() < 1e-10
        assert ((ahead.covariance - P) / torch.outer(scale, scale)).abs().max() < 1e-10
