"""Loads between nodes, natively: what they give, and its gradients, as eagerly."""

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.engine.chain import native
from torchbeam.engine.chain.adjoint import AdjointProgram
from torchbeam.engine.chain.program import StepProgram

STEPS = 12


def run(engine, order, plane, method, moving, batch, **options):
    """A beam that falls onto a ball and slides over it: places and work at the end, gradients by
    all numbers of the contact.
    """
    p = {
        "place": torch.tensor([0.83, 0.0, -0.0605]),
        "radius": torch.tensor(0.05),
        "own": torch.tensor(0.01),
        "thickness": torch.tensor(2e-3),
        "force": torch.tensor([2.0, 5.0, 9.0] if batch else 5.0),
        "friction": torch.tensor(0.3),
        "slip_speed": torch.tensor(0.5),
        "damping": torch.tensor(1e-3),
        "EI": torch.tensor(1.0),
    }
    p = {name: x.requires_grad_() for name, x in p.items()}
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=p["EI"], mass=0.2, inertia=1e-4)
    place = p["place"]
    if moving:
        p.pop("place")
        place = lambda t: torch.stack((0.83 + 0.3 * t, 0 * t, 0.1 * t - 0.0605))  # noqa: E731
    contact = tb.Contact(
        tb.Sphere(place, p["radius"]),
        radius=p["own"],
        points=4,
        **{name: p[name] for name in ("thickness", "force", "friction", "slip_speed", "damping")},
    )
    side = 0.1 if plane is None else 0.0
    effects = [tb.Gravity((0, 0, -9.81)), tb.TipLoad(force=(0, side, 0)), contact]
    beam = tb.Beam.straight(1.0, 2, section, order=order)
    t = torch.tensor([0.0, 4e-3 * STEPS])
    solution = tb.simulate(
        tb.Scene(beam, effects, plane=plane), t, step=4e-3, engine=engine, method=method, **options
    )
    work = solution.energy.work[-1]
    answer = (solution.tip.position[-1] * torch.tensor([1.0, 2.0, 3.0])).sum() + work.sum()
    return solution.nodes[-1], work, torch.autograd.grad(answer, list(p.values()))


@pytest.mark.parametrize(
    ("order", "plane", "method", "moving", "batch", "options"),
    [
        (1, None, "midpoint", False, True, {}),
        (2, "xz", "midpoint", False, False, dict(conserve=True)),
        (1, "xz", "generalized_alpha", True, False, {}),
    ],
    ids=["space", "plane, order 2, conserving", "generalized alpha, moving"],
)
def test_eager_and_native_agree(order, plane, method, moving, batch, options):
    """Motion to 1e-12, gradients to 1e-9 of the largest; the contact acts in them all."""
    ways = [
        run(engine, order, plane, method, moving, batch, **options)
        for engine in ("eager", "compiled")
    ]
    (nodes, work, gradients), (native, native_work, native_gradients) = ways
    assert_close(native, nodes, rtol=0, atol=1e-12)
    assert_close(native_work, work, rtol=0, atol=1e-12)
    for own, other in zip(native_gradients, gradients, strict=True):
        assert other.abs().amax() > 0
        assert_close(own, other, rtol=1e-9, atol=1e-9 * other.abs().amax().item())


def test_equilibria_agree():
    """A cantilever that leans on a floor."""
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.4, inertia=1e-4)
    heights = torch.tensor([-0.05, -0.02, -1.0])
    floor = tb.Plane(torch.stack((0 * heights, 0 * heights, heights), -1), (0, 0, 1.0))
    contact = tb.Contact(floor, thickness=2e-3, force=5.0)
    beam = tb.Beam.straight(1.0, 6, section, order=2)
    scene = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), contact], plane="xz")
    eager, native = (tb.equilibrium(scene, engine=engine) for engine in ("eager", "compiled"))
    assert_close(native.position, eager.position, rtol=0, atol=1e-11)
    contact = tb.Contact(tb.Plane((0, 0, -0.05), (0, 0, 1.0)), thickness=2e-3, force=5.0)
    one = tb.Scene(beam, [tb.Gravity((0, 0, -9.81)), contact], plane="xz")
    end = tb.path(one).state[-1]  # without native code, which does not take this
    assert_close(end.position, eager.position[0], rtol=0, atol=1e-7)
    lifted = 0.4 * 9.81 - native.root.force[..., 2]
    assert (lifted[:2] > 1.0).all() and lifted[2].abs() < 1e-8


def elbow(engine, order, plane, method):
    """Two beams on a hinge with a body at the end of the second: the first falls onto a ball that
    it alone meets, both onto a floor; forces of the joint too.
    """
    p = {
        "radius": torch.tensor(0.05),
        "force": torch.tensor([2.0, 5.0]),
        "friction": torch.tensor(0.3),
        "height": torch.tensor(-0.0121),
        "EI": torch.tensor(1.0),
    }
    p = {name: x.requires_grad_() for name, x in p.items()}
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=p["EI"], mass=0.2, inertia=1e-4)
    own = dict(thickness=2e-3, slip_speed=0.5, radius=0.01)
    zero = torch.zeros(())
    floor = tb.Plane(torch.stack((zero, zero, p["height"])), (0, 0, 1.0))
    effects = [
        tb.Gravity((0.2, 0, -9.81)),
        tb.Contact("fore", tb.Sphere((0.3, 0, -0.0605), p["radius"]), force=p["force"], **own),
        tb.Contact(floor, force=5.0, friction=p["friction"], **own),
    ]
    fore = tb.Beam.straight(0.5, 2, section, order=order)
    arm = tb.Beam.straight(0.5, 2, section, root=(0.5, 0, 0), order=order)
    scene = tb.Scene(
        {"fore": fore, "arm": arm, "load": tb.Body(0.1, 1e-4, position=(1.0, 0, 0))},
        effects,
        joints=[tb.Hinge(("fore", -1), ("arm", 0), axis=(0, 1, 0)), tb.Weld(("arm", -1), "load")],
        supports=[tb.Support(("fore", 0))],
        plane=plane,
    )
    t = torch.tensor([0.0, 0.048])
    solution = tb.simulate(scene, t, step=8e-3, engine=engine, method=method)
    work, force = solution.energy.work[-1], solution.joint[0].force[-1]
    answer = solution["load"].position[-1].sum() + work.sum() + 1e-2 * force.sum()
    return solution.nodes[-1], work, torch.autograd.grad(answer, list(p.values()))


@pytest.mark.parametrize(
    ("order", "plane", "method"),
    [  # the others: each of their parts in test_eager_and_native_agree
        (1, "xz", "midpoint"),
        pytest.param(1, None, "midpoint", marks=pytest.mark.long),
        pytest.param(2, "xz", "generalized_alpha", marks=pytest.mark.long),
    ],
)
def test_structures_agree(order, plane, method):
    """Motion to 1e-12, gradients to 1e-9 of the largest: what touches one beam, and what all."""
    nodes, work, gradients = elbow("eager", order, plane, method)
    native, native_work, native_gradients = elbow("compiled", order, plane, method)
    assert_close(native, nodes, rtol=0, atol=1e-12)
    assert_close(native_work, work, rtol=0, atol=1e-12)
    for own, other in zip(native_gradients, gradients, strict=True):
        assert other.abs().amax() > 0
        assert_close(own, other, rtol=1e-9, atol=1e-9 * other.abs().amax().item())


def test_what_changes_has_the_room_of_a_strain(monkeypatch):
    """Forwards and in the adjoint, whatever acts between nodes."""
    room = {}

    def watched(made, name):
        lay = made._layout

        def laid(self):
            layout = lay(self)
            room[name] = layout.fields("change")[name][1]
            return layout

        monkeypatch.setattr(made, "_layout", laid)

    monkeypatch.setattr(native, "stored_layout", lambda key: None)
    watched(StepProgram, "stress")
    watched(AdjointProgram, "gap_bar")
    section = tb.Section.circle(0.01, 1e7, 0.3, 1e3)
    floor = tb.Contact(tb.Plane((0, 0, -1.0), (0, 0, 1.0)), radius=0.01, thickness=1e-2, force=1.0)
    pull = torch.tensor(0.5, requires_grad=True)
    tip = tb.TipLoad(moment=pull * torch.tensor([0.0, 1.0, 0.0]))
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [floor, tip], plane="xz")
    t = torch.tensor([0.0, 2e-3])
    solution = tb.simulate(scene, t, step=1e-3, method="generalized_alpha", engine="compiled")
    solution.tip.position[-1].sum().backward()
    assert room == {"stress": 3, "gap_bar": 3}
