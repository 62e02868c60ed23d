"""The explicit nodal form: Newton's and Euler's equations at random states, consistency with the
implicit step.
"""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.nodal_cases import orders, scene, state
from torchbeam.math import quaternions as quat
from torchbeam.nodal.element import forces
from torchbeam.nodal.loads import external
from torchbeam.nodal.rates import Rates

T = torch.tensor(0.2)


@pytest.fixture(params=[None, "one", "six"])
def rates(request):
    return Rates.of(scene(batch=(3,), damping=request.param), {})


def test_pack_and_unpack_are_inverse(rates):
    start = state(rates.model.scene)
    fields = start.position, start.rotation, start.velocity, start.spin
    nodes, spin, _ = rates.unpack(T, rates.pack(start))
    for new, old in zip((*nodes[:3], spin), fields, strict=True):
        assert_close(new, old.expand_as(new), rtol=0, atol=1e-15)


def test_rates_of_position_and_rotation(rates):
    """r' = v and R' = R ~Omega, by forward mode through the quaternion's matrix."""
    start = state(rates.model.scene)
    y, t = rates.pack(start), torch.tensor(0.2)

    def placed(y):
        nodes = rates.unpack(t, y)[0]
        return nodes.position, quat.matrix(nodes.rotation)

    _, (r_rate, R_rate) = torch.func.jvp(placed, (y,), (rates(t, y),))
    assert_close(r_rate, start.velocity, rtol=0, atol=1e-14)
    assert_close(R_rate, quat.matrix(start.rotation) @ quat.skew(start.spin), rtol=0, atol=1e-13)


def test_momentum_rates(rates):
    """d/dt (m v) = f and d/dt (R J Omega) = m at every free node, loads and internal forces on the
    right.
    """
    start, t, model = state(rates.model.scene), torch.tensor(0.2), rates.model
    y = rates.pack(start)

    def momenta(y):
        nodes, spin, _ = rates.unpack(t, y)
        return model.inertia.mass * nodes.velocity, quat.rotate(
            nodes.rotation, model.inertia.rotary.section_momentum(spin)
        )

    _, (p_rate, H_rate) = torch.func.jvp(momenta, (y,), (rates(t, y),))
    nodes = rates.unpack(t, y)[0]
    kin = model.kinematics(start.position, start.rotation)
    net = external(model, nodes, rates.conditions(t)) - model.assembly.to_nodes(
        forces(kin, rates.stress(nodes, rates.conditions(t)), model.length)
    )
    assert_close(torch.cat((p_rate, H_rate), -1)[..., 1:, :], net[..., 1:, :], rtol=0, atol=1e-11)
    assert_close(
        rates.state(t, y, start.status).reaction[..., 0, :], -net[..., 0, :], rtol=0, atol=1e-12
    )


def test_stress_follows_strain_and_strain_rate(rates):
    """S [F; M] = strain + rate (strain rate), the strain rate by forward mode along the motion."""
    start, model = state(rates.model.scene), rates.model
    y = rates.pack(start)

    def strains(y):
        r, q, *_ = rates.unpack(T, y)[0]
        return model.strain(model.kinematics(r, q))

    value, rate = torch.func.jvp(strains, (y,), (rates(T, y),))
    if model.law.damped:
        retardation = model.law.retardation_time
        value = value + (
            (retardation @ rate[..., None])[..., 0]
            if retardation.shape[-1] == 6
            else retardation[..., 0] * rate
        )
    stress = rates.stress(rates.unpack(T, y)[0], rates.conditions(T))
    assert_close((model.law.S @ stress[..., None])[..., 0], value, rtol=0, atol=1e-11)


def test_energy_rate_is_power_less_dissipation(rates):
    """d/dt (kinetic + strain) = power of the loads - rate of damping, never more than the power:
    the damping matrix is positive semidefinite. By forward mode at a random state.
    """
    start, model, t = state(rates.model.scene), rates.model, torch.tensor(0.2)
    y = rates.pack(start)

    def energy(y):
        nodes, spin, _ = rates.unpack(t, y)
        return model.kinetic_energy(
            nodes.position, nodes.rotation, nodes.velocity, spin
        ) + model.strain_energy(nodes.position, nodes.rotation)

    y_rate = rates(t, y)
    _, gained = torch.func.jvp(energy, (y,), (y_rate,))
    lost = y_rate[..., -1] - gained
    if not model.law.damped:
        assert_close(lost, torch.zeros(3), rtol=0, atol=1e-11)
    else:
        assert (lost > 0).all()


def off_axis(**options):
    """A scene of every load whose masses lie off its nodes, and a state that its supports allow: it
    has moved for 0.1 s.
    """
    of = scene()
    bodies = [
        tb.PointMass(0.4, inertia=(0.1, 0.12, 0.15), offset=(0.1, 0.2, -0.3), node=node)
        for node in (0, 2, -1)
    ]
    of = tb.Scene(
        of.beam,
        [*(load for load in of.effects if not (load.follower and "small" in options)), *bodies],
        **options,
    )
    stepper = tb.Stepper(of, 0.05, lumped=True)
    return of, stepper(stepper(stepper.rest()))


@pytest.mark.parametrize(
    "supports",
    [
        (tb.Support(0, rotation="xz"),),
        (tb.Support(0), tb.Support(-1, rotation="")),
        (tb.Support(0), tb.Support(2, "yz", "")),
        (
            tb.Support(0, turn=lambda t: 0.3 * torch.stack((t, t * t, 0 * t), -1)),
            tb.Support(
                -1, displacement=lambda t: 0.2 * torch.stack((t * t, 0 * t, torch.sin(3 * t)), -1)
            ),
        ),
        (),
    ],
    ids=["a hinge", "a pin beside a clamp", "a slide", "clamps that move", "free"],
)
def test_reactions_balance_the_rate_of_momentum(supports):
    """d/dt (m v_c) summed = loads + reactions, and the same of moments about frame a's origin,
    where masses lie off their nodes: a body swings about a node that is held in part, and the
    support feels it. By forward mode.
    """
    of, start = off_axis(supports=supports)
    rates = Rates.of(of, {})
    inertia, y, t = rates.model.inertia, rates.pack(start), start.t

    def momenta(t, y):
        nodes, spin, _ = rates.unpack(t, y)
        P, H = inertia.momenta(
            nodes.rotation, inertia.centre_velocity(nodes.rotation, nodes.velocity, spin), spin
        )
        centre = nodes.position + inertia.offset.turned(nodes.rotation).offset
        return P.sum(-2), (torch.linalg.cross(centre, P) + H).sum(-2)

    _, (P_rate, H_rate) = torch.func.jvp(momenta, (t, y), (torch.ones_like(t), rates(t, y)))
    load = external(rates.model, rates.unpack(t, y)[0], rates.conditions(t))
    for support, reaction in zip(
        of.supports, rates.state(t, y, start.status).reaction, strict=True
    ):
        load[support.node] += reaction
    assert_close(load[:, :3].sum(0), P_rate, rtol=0, atol=1e-11)
    assert_close(
        (torch.linalg.cross(start.position, load[:, :3]) + load[:, 3:]).sum(0),
        H_rate,
        rtol=0,
        atol=1e-11,
    )


def test_small_rotations_are_linear():
    """With small=True rates are linear in the motion, spins of masses off their nodes included:
    twice the departure, twice the rates, but for the power.
    """
    of, start = off_axis(small=True)
    rates = Rates.of(of, {})
    still, y = rates.pack(tb.rest(of)), rates.pack(start)
    of_rest, once, twice = (rates(start.t, still + k * (y - still))[:-1] for k in (0, 1, 2))
    assert_close(
        twice - of_rest, 2 * (once - of_rest), rtol=0, atol=1e-11 * float(once.abs().max())
    )
    acceleration = tb.sensors.NodeAcceleration(-1, of, lumped=True)(start)
    assert_close(once[12 * 2 + 9 : 12 * 2 + 12], acceleration, rtol=0, atol=1e-11)


def test_supports_that_a_frame_carries_are_refused():
    """Of a moving frame the explicit form takes clamps alone: it would hold the absolute velocity
    of other supports.
    """
    for support in (tb.Support(-1, rotation="yz"), tb.Support(0, rotation="")):
        of = tb.Scene(
            scene().beam, supports=(support,), frame=tb.Frame(angular_velocity=(0, 0, 1.0))
        )
        with pytest.raises(ValueError, match="midpoint"):
            Rates.of(of, {})


@pytest.mark.parametrize("damping", [None, "six"])
def test_implicit_step_is_consistent_with_the_rates(damping):
    """(state after one implicit step - state)/dt, lumped mass, tends to the explicit rates: the
    difference halves with dt (first order in a forward difference; observed order 1 within 0.1 at
    1e-3 to 2.5e-4 s).
    """
    of = scene(damping=damping)
    rates, start = Rates.of(of, {}), state(of)
    y = rates.pack(start)
    exact = rates(torch.tensor(0.0), y)
    errors = []
    for dt in (1e-3, 5e-4, 2.5e-4):
        after = rates.pack(tb.Stepper(of, dt, lumped=True, tolerance=1e-12)(start))
        errors.append(((after - y) / dt - exact).abs().max().item())
    assert_close(orders(errors), torch.ones(2), rtol=0, atol=0.1)
