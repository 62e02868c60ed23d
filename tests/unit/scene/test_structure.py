"""Structures: several beams and bodies as the rows of one scene, names in the place of numbers."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.structures import CASES, SECTION, TIGHT, G, alone_and_together, beams, structure


@pytest.mark.parametrize(
    ("of", "plane"), [("order 1", None), ("order 1", "xy"), ("order 2", "xy"), ("linked", None)]
)
def test_two_beams_in_one_scene_are_two_scenes(of, plane):
    """Without joints each beam moves, and stands, as by itself, to rounding: loads along all beams,
    by their names or without, see each one's own arclength, elements and internal states.
    """
    by_name = ("arm", "bow") if plane else ()
    alone, both = alone_and_together(CASES[of], by_name, plane=plane)
    t = torch.linspace(0, 0.08, 3)
    for solve, near in (
        (lambda scene: tb.simulate(scene, t, **TIGHT).state, 1e-12),
        (lambda scene: tb.equilibrium(scene, tolerance=1e-13, engine="eager"), 1e-12),
    ):
        whole = solve(both)
        for k, scene in enumerate(alone.values()):
            expected, part = solve(scene), both.beam.parts[k]
            for field, rows in (
                ("position", part.nodes),
                ("rotation", part.nodes),
                ("velocity", part.nodes),
                ("spin", part.nodes),
                ("stress", part.stations),
                ("reaction", slice(k, k + 1)),
            ):
                size = 1 + getattr(expected, field).abs().max().item()
                assert_close(
                    getattr(whole, field)[..., rows, :],
                    getattr(expected, field),
                    rtol=0,
                    atol=near * 100 * size,
                )


def test_bodies_fall_and_turn_freely():
    """g t^2/2 to rounding, beside a beam that stays where it is; a force and a moment on a ball
    bring p = F t and L = M t.
    """
    arm = beams()["arm"]
    hub = tb.Body(0.3, 1e-3, position=(0, 2.0, 0))
    scene = tb.Scene(
        {"arm": arm, "ball": tb.Body(0.5, 2e-3), "hub": hub},
        [tb.Gravity(G, on="hub"), tb.PointLoad("ball", force=(0.1, 0, 0), moment=(0, 1e-3, 0))],
        supports=[tb.Support(("arm", 0))],
    )
    t = torch.linspace(0, 0.2, 3)
    sol = tb.simulate(scene, t, step=0.02, engine="eager")
    arm_end, ball, fallen = sol.nodes[-1, :, 3], sol.nodes[-1, :, 4], sol.nodes[-1, :, 5]
    assert_close(arm_end, arm.nodes[:, -1])
    assert_close(
        fallen, torch.tensor([[0, 2 - 9.81 * 0.2**2 / 2, 0]]).expand(2, 3), rtol=0, atol=1e-12
    )
    assert_close(
        ball, torch.tensor([[0.1 / 0.5 * 0.2**2 / 2, 0, 0]]).expand(2, 3), rtol=0, atol=1e-12
    )
    assert_close(
        sol.state[-1].spin[:, 4],
        torch.tensor([[0, 1e-3 / 2e-3 * 0.2, 0]]).expand(2, 3),
        rtol=0,
        atol=1e-12,
    )


def test_names_become_rows_and_stay_what_the_user_wrote():
    scene = structure()
    assert [part.name for part in scene.beam.parts] == ["arm", "bow", "hub"]
    assert (
        scene.beam.node_count == 4 + 5 + 1
        and scene.beam.station_count == 7
        and scene.beam.element_count == 7
    )
    assert [int(effect.node) for effect in scene.effects[:2]] == [6, 2] and scene.joints[
        0
    ].ends == (3, 9)
    again = replace(scene, effects=[*scene.effects, tb.PointLoad("hub", force=(0, 0, 1.0))])
    assert [int(effect.node) for effect in again.effects if effect.node is not None] == [6, 2, 9]
    assert again.joints[0].ends == (3, 9) and again.supports[0].node == 0
    for words in (
        "at node ('bow', 2)",
        "LineLoad on 'bow'",
        "clamp of node ('arm', 0)",
        "Weld of ('arm', -1) and 'hub'",
        "PointLoad at node 'hub'",
    ):
        assert words in repr(again), words
    assert structure(supports=None).supports == ()


def test_structures_save_load_and_change_their_dtype(tmp_path):
    scene = structure()
    torch.save(scene, tmp_path / "scene.pt")
    again = torch.load(tmp_path / "scene.pt", weights_only=True)
    assert repr(again) == repr(scene) and again.effects[0].node.given == ("bow", 2)
    narrow = scene.to(torch.float32)
    assert narrow.dtype == torch.float32 and narrow.beam.masses[0].mass.dtype == torch.float32
    assert narrow.joints[0].ends == (3, 9)


POINT = (0.1, 0.0, 0.0)


def test_parts_keep_gradients():
    """By what bodies and beams are made of: the structure's tensors are theirs."""
    x = torch.tensor(0.1, requires_grad=True)
    hub = tb.Body(2 * x, x * torch.eye(3), position=(x, 0, 1.0))
    scene = tb.Scene({"arm": tb.Beam.straight(1 + x, 2, SECTION), "hub": hub})
    total = scene.beam.nodes.sum() + scene.bodies[0].mass + scene.bodies[0].inertia.sum()
    # of nodes at 0, 1/2 and 1 of the length; x; 2 x; 3 x
    assert torch.autograd.grad(total, x)[0] == 0.5 + 1 + 1 + 2 + 3


ARM, BOW = beams().values()
HUB = tb.Body(0.3, 1e-3, position=(3.0, 0, 0))
POST = tb.Beam.straight(1.0, 2, SECTION, direction=(0, 0, 1))


def scene_of(joints, **options):
    return lambda: tb.Scene({"arm": ARM, "bow": BOW, "hub": HUB}, joints=joints(), **options)


# fmt: off
REFUSED = {
    "node = 3 was given in a structure; one of its nodes is wanted: ('arm', 0 to 3)": lambda:
    tb.Scene(
        {"arm": ARM}, [tb.PointLoad(3, force=G)]),
    "node = ('arm', 3) was given in a scene of one beam": lambda: tb.Scene(ARM,
        [tb.PointLoad(("arm", 3), force=G)]),
    "node = ('leg', 3) was given; the structure has the nodes ('arm', 0 to 3), the body 'hub'":
    lambda: tb.Scene(
        {"arm": ARM, "hub": HUB}, [tb.PointLoad(("leg", 3), force=G)]),
    "node = ('arm', 4) was given; 'arm' has the nodes 0 to 3": lambda: tb.Scene(
        {"arm": ARM}, [tb.PointLoad(("arm", 4), force=G)]),
    "node = 'arm' was given": lambda: tb.Scene({"arm": ARM}, [tb.PointLoad("arm", force=G)]),
    "the part 'leg' was asked for; there are 'arm'": lambda: tb.Scene({"arm": ARM},
        [tb.LineLoad(force=G, on="leg")]),
    "on = 'hub' was given; that is a body": lambda: tb.Scene({"arm": ARM, "hub": HUB},
                                                             [tb.LineLoad(force=G, on="hub")]),
    "on = 'arm' was given in a scene of one beam": lambda: tb.Scene(ARM,
        [tb.LineLoad(force=G, on="arm")]),
    "PerElement of shape (3, 3) was given; (..., 4, 3)": lambda: tb.Scene(
        {"arm": ARM, "bow": BOW}, [tb.LineLoad(force=tb.PerElement([[0, 0, 1.0]] * 3))]),
    "node = -1 was given in a structure": lambda: tb.Scene({"arm": ARM}, [tb.TipLoad(force=G)]),
    "the node of a support = 0 was given in a structure": lambda: tb.Scene({"arm": ARM},
        supports=[tb.Support(0)]),
    "two supports of node ('arm', 3)": lambda: tb.Scene(
        {"arm": ARM}, supports=[tb.Support(("arm", -1)), tb.Support(("arm", 3))]),
    "root was given in a structure": lambda: tb.Scene({"arm": ARM}, root=tb.RootMotion()),
    "'arm' of type int was given": lambda: tb.Scene({"arm": 3}),
    "the name 3 was given": lambda: tb.Scene({3: ARM}),
    "no parts were given": lambda: tb.Scene({}),
    "beams of different orders": lambda: tb.Scene({"arm": ARM, "bow": beams(order=2)["bow"]}),
    "linked interpolation beside others": lambda: tb.Scene({"arm": ARM, "bow": BOW.linked()}),
    "the parts of a structure": lambda: tb.Scene({"arm": ARM,
        "hub": tb.Body(torch.ones(3), 1.0, position=torch.zeros(3, 3))}),
    "inertia of shape (5,) was given; one number": lambda: tb.Body(torch.ones(5), torch.ones(5)),
    "the body 'dot' without inertia": lambda: tb.Scene({"arm": ARM, "dot": tb.Body(1.0)}),
    "a Ball was given in a scene of one beam": lambda: tb.Scene(ARM,
                                                                joints=[tb.Ball(("arm", 0), None)]),
    "which are 2.002 m apart": scene_of(lambda: tb.Ball(("arm", 0), ("bow", 0))),
    "two joints of ('arm', -1) and ('arm', 0) at one place": scene_of(lambda: [
        tb.Weld(("arm", 0), ("arm", -1)), tb.Hinge(("arm", -1), ("arm", 0), at=ARM.nodes[:, -1])]),
    "a Weld of ('arm', 0) with itself": scene_of(lambda: tb.Weld(("arm", 0), ("arm", 0))),
    "a Weld of the ground with itself": lambda: tb.Weld(None, None),
    "small=True with the limit of a Ball": scene_of(
        lambda: tb.Ball(("arm", 0), None, limit=0.1, limit_stiffness=1.0), small=True),
    "a joint's part = 'arm' was given": scene_of(lambda: tb.Ball(("arm", POINT), None)),
    "the ground without at=": scene_of(lambda: tb.Distance(("arm", 0), None)),
    "at a place and at a point of a body": scene_of(lambda: tb.Ball(("hub", POINT), None,
                                                                    at=POINT)),
    "two axes that are not at right angles": scene_of(lambda: tb.Universal("hub", None,
                                                                           second=(1.0, 1.0, 0))),
    "lies within an element of order 2": lambda: tb.Scene(beams(order=2),
                                                          joints=[tb.Weld(("arm", 1), None)]),
    "a structure was given for form='minimal'": lambda: tb.simulate(
        structure(joints=()), torch.linspace(0, 0.1, 2), form="minimal"),
    "a Weld was given to an explicit method": lambda: tb.simulate(structure(),
        torch.linspace(0, 0.1, 2), method="rk4"),
    "the same in all parts (up= turns it)": lambda: tb.Stepper(tb.Scene({"arm": ARM, "post": POST},
                                                                        plane="xz"), 0.1),
}
# fmt: on


@pytest.mark.parametrize("sentence", REFUSED)
def test_refusal(sentence):
    with pytest.raises(ValueError) as caught:
        made = REFUSED[sentence]()
        pytest.fail(f"{made} was taken")
    assert sentence in str(caught.value) and "\n" not in str(caught.value)


def test_beams_are_damped_each_by_its_own():
    """One value on one beam and six on another, or on one alone: each moves as the beam by
    itself.
    """
    tau = {"arm": 0.01, "bow": (0.01, 0.0, 0.0, 0.02, 0.03, 0.03)}
    t, push = torch.linspace(0, 0.04, 3), (0, 0.5, 0.3)
    held = [tb.Support(("arm", 0)), tb.Support(("bow", 0))]
    for damped in (("arm", "bow"), ("arm",)):
        loads = [tb.PointLoad((name, -1), force=push) for name in tau]
        both = tb.Scene(
            beams(), [*loads, *(tb.Damping(tau[name], on=name) for name in damped)], supports=held
        )
        sol = tb.simulate(both, t, **TIGHT)
        for name, beam in beams().items():
            own_damping = [tb.Damping(tau[name])] if name in damped else []
            expected = tb.simulate(
                tb.Scene(beam, [tb.TipLoad(force=push), *own_damping]), t, **TIGHT
            )
            assert_close(sol[name].nodes, expected.nodes, rtol=0, atol=1e-11)
    with pytest.raises(ValueError, match=r"tau from 0 to 0\.01 s was given"):  # as of six values
        tb.simulate(both, t, method="midpoint4", **TIGHT)
    with pytest.raises(ValueError, match="at most one is wanted, or one on each beam"):
        tb.Scene(beams(), [tb.Damping(0.1), tb.Damping(0.1, on="arm")])
