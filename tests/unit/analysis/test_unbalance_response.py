"""Unbalance response of rotors against closed forms."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb

SPEED = torch.tensor([20.0, 90.0, 155.0, 300.0])  # rad/s, below and above critical speeds
U = 8e-4  # kg m


def test_an_overhung_disc():
    """A shaft without mass (1e-9 kg/m) in a long bearing carries a disc, with damping of the disc
    against the ground of c v. With r = y + i z the closed form is that of deflection and slope,
    (K + [[i c W - m W^2, 0], [0, (Jp - Jd) W^2]]) [r, theta] = [U W^2, 0]; all of it is a forward
    whirl. One element of order 2 bends exactly by loads at its ends; rounding beside the
    shear stiffness is left. With GA = math.inf the tangent gets a flexibility in its place
    (REGULARISATION): the amplitude is then 3e-7 off, 7e-6 beside the critical speed.
    """
    L, EI, GA, m, Jd, Jp, c = 0.4, 4e3, 1e9, 8.0, 0.04, 0.08, 30.0
    shaft = tb.Section.from_stiffness(EA=1e9, GA=GA, GJ=1e4, EI=EI, mass=1e-9, inertia=1e-12)
    disc = tb.PointMass(m, inertia=(Jp, Jd, Jd), node=("shaft", -1))

    def drag(position, rotation, velocity, spin, t):
        return -c * velocity, None

    scene = tb.Scene(
        {"shaft": tb.Beam.straight(L, 1, shaft, order=2)},
        [disc, tb.Load(drag, node=("shaft", -1))],
        joints=[tb.Hinge(None, ("shaft", 0), axis=(1, 0, 0))],
    )
    motion = tb.unbalance_response(scene, SPEED, {("shaft", -1): (0.0, 0.0, U)})
    y, z = motion[:, scene.beam.row(("shaft", -1)), 1:3].unbind(-1)
    flexibility = torch.tensor([[L**3 / 3 + L * EI / GA, L**2 / 2], [L**2 / 2, L]]) / EI
    stiffness = torch.linalg.inv(flexibility).to(torch.complex128).repeat(len(SPEED), 1, 1)
    stiffness[:, 0, 0] += 1j * c * SPEED - m * SPEED**2
    stiffness[:, 1, 1] += (Jp - Jd) * SPEED**2
    force = torch.stack((U * SPEED**2, 0 * SPEED), -1).to(stiffness.dtype)
    wanted = torch.linalg.solve(stiffness, force)[:, 0]
    assert_close(z, wanted, rtol=2e-9, atol=0)  # the heavy spot is at z at t = 0
    assert_close(y, 1j * wanted, rtol=2e-9, atol=0)  # and moves on to -y


def test_bearings_that_differ_by_direction():
    """A rigid rotor in a housing on springs and dampers: y and z are oscillators of one mass each,
    k - m W^2 + i c W, driven by U W^2 with a quarter of a turn between them; a batch of springs,
    and the derivative by one. Rounding alone is left.
    """
    m, housing = 5.0, 1.5
    k, c = torch.tensor([[4e4, 9e4], [5e4, 8e4]]), (20.0, 60.0)  # (batch, direction)

    def response(ky):
        parts = {
            "across": tb.Body(1e-12, 1e-12),
            "housing": tb.Body(housing, 0.01),
            "rotor": tb.Body(m, (0.02, 0.01, 0.01)),
        }
        joints = [
            tb.Slider(None, "across", axis=(0, 1, 0), stiffness=ky, damping=c[0]),
            tb.Slider("across", "housing", axis=(0, 0, 1), stiffness=k[:, 1], damping=c[1]),
            tb.Hinge("housing", "rotor", axis=(1, 0, 0)),
        ]
        scene = tb.Scene(parts, joints=joints)
        motion = tb.unbalance_response(scene, SPEED, {"rotor": (0.0, U, 0.0)})
        return motion[..., scene.beam.row("rotor"), 1:3]

    W = SPEED[:, None, None]
    wanted = U * W**2 / (k - (m + housing) * W**2 + 1j * W * torch.tensor(c))
    wanted = wanted * torch.tensor([1, -1j])
    got = response(k[:, 0])
    assert got.shape == (len(SPEED), 2, 2)
    assert_close(got, wanted, rtol=1e-9, atol=0)
    ky = k[:, 0].clone().requires_grad_()
    (slope,) = torch.autograd.grad(response(ky)[..., 0].real.sum(), ky)
    assert_close(
        slope, -(wanted[..., 0] ** 2 / (U * W[..., 0] ** 2)).real.sum(0), rtol=1e-8, atol=0
    )


def test_refusals():
    disc = tb.Body(2.0, (0.02, 0.01, 0.01), position=(1.0, 0, 0))
    joint = tb.Hinge(None, "disc", axis=(1, 0, 0))
    rotor = tb.Scene({"disc": disc}, joints=[joint])
    with pytest.raises(ValueError, match="a node of the rotor, on its axis"):
        off = tb.Body(2.0, (0.02, 0.01, 0.01), position=(1.0, 0.1, 0))
        parts = {"disc": disc, "off": off}
        both = tb.Scene(parts, joints=[joint, tb.Weld("disc", "off")])
        tb.unbalance_response(both, [1.0], {"off": (0, 1e-3, 0)})
    with pytest.raises(ValueError, match=r"node -> \(\.\.\., 3\) kg m"):
        tb.unbalance_response(rotor, [1.0], 1e-3)
    with pytest.raises(ValueError, match="looks different from different sides"):
        flat = tb.Section.rectangle(0.02, 0.01, E=210e9, nu=0.3, rho=7800.0)
        parts = {"bar": tb.Beam.straight(1.0, 1, flat)}
        bar = tb.Scene(parts, joints=[tb.Hinge(None, ("bar", 0), axis=(1, 0, 0))])
        tb.unbalance_response(bar, [10.0], {("bar", -1): (0, 1e-3, 0)})
