"""Scene: what it finds in its effects, batches, inputs. Bad input: test_refusals."""

import copy
import pickle
from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.core.leaves import leaves

SECTION = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
BEAM = tb.Beam.straight(1.0, 2, SECTION)
RK4 = dict(method="rk4", options={"step_size": 0.01})
FORMS = {"nodal": dict(step=0.01), "minimal": RK4, "block_rate": RK4}


def test_effects_are_sorted_by_hook():
    load, weight = tb.TipLoad(force=(0, 0, 1.0)), tb.Gravity((0, 0, -9.81))
    damping = tb.Damping(0.1)
    scene = tb.Scene(BEAM, [load, damping, weight])
    assert [type(e) for e in scene.loads] == [tb.TipLoad, tb.Gravity] and isinstance(
        scene.damping, tb.Damping
    )
    assert [type(e) for e in scene.effects] == [tb.TipLoad, tb.Damping, tb.Gravity]
    bare = tb.Scene(BEAM)
    assert (
        bare.loads == () and bare.damping is None and bare.inputs == {} and bare.batch_shape == ()
    )


def test_a_single_effect_needs_no_list():
    load = tb.TipLoad(force=(0, 0, 1.0))
    assert [type(e) for e in tb.Scene(BEAM, load).loads] == [tb.TipLoad]


def test_batch_is_that_of_everything_together():
    """Lengths (4, 1), a load (3,), tau (4, 1): 4 x 3 scenes; the last axis of a tau for each strain
    is no batch axis.
    """
    beam = tb.Beam.straight(torch.rand(4, 1) + 1, 2, SECTION)
    load = tb.TipLoad(force=torch.rand(3, 3))
    assert tb.Scene(beam, [load, tb.Damping(torch.rand(4, 1))]).batch_shape == (4, 3)
    assert tb.Scene(BEAM, [tb.Damping(tuple(torch.rand(6)))]).batch_shape == ()
    assert tb.Scene(BEAM, [tb.Damping(torch.rand(6), six=True)]).batch_shape == ()
    # samples, as in a batch of five
    assert tb.Scene(BEAM, [tb.Damping(torch.rand(6))]).batch_shape == (6,)


def test_inputs_are_found_and_made_tensors():
    """One name may drive two loads; numbers become tensors of the scene's dtype."""
    u = tb.Input("u", 3)
    scene = tb.Scene(BEAM, [tb.TipLoad(force=u, moment=tb.Input("m", 3)), tb.LineLoad(force=u)])
    assert scene.inputs == {"u": 3, "m": 3}
    given = scene.tensors({"u": (0, 0, 1), "m": torch.zeros(5, 3)})
    assert given["u"].dtype == torch.float64 and given["m"].shape == (5, 3)


def test_an_input_is_the_load_it_stands_for():
    """Equilibrium and a step under an input = the same under the load's value, bit for bit."""
    force = torch.tensor([0.1, 0.2, 0.3])
    fixed, driven = (tb.Scene(BEAM, [tb.TipLoad(force=f)]) for f in (force, tb.Input("u", 3)))
    assert_close(
        tb.equilibrium(driven, inputs={"u": force}).position,
        tb.equilibrium(fixed).position,
        rtol=0,
        atol=0,
    )
    one, other = tb.Stepper(fixed, 0.1), tb.Stepper(driven, 0.1)
    assert_close(other(other.rest(), u=force).position, one(one.rest()).position, rtol=0, atol=0)


def test_inputs_go_by_name():
    """Everywhere, whatever the name: that of an option too. To a stepper also by keyword: the same
    bits either way.
    """
    force = torch.tensor([0.1, 0.2, 0.3])
    t = torch.tensor([0.0, 0.02])
    for name in ("u", "dt", "step"):
        scene, inputs = tb.Scene(BEAM, [tb.TipLoad(force=tb.Input(name, 3))]), {name: force}
        stepper = tb.Stepper(scene, 0.1)
        ends = [stepper(stepper.rest(), inputs=inputs), tb.equilibrium(scene, inputs=inputs)]
        ends += [
            tb.simulate(scene, t, form=form, inputs=inputs, **how).state[-1]
            for form, how in FORMS.items()
        ]
        assert all(state.position[-1, 1] > 0 for state in ends)
        if name == "u":
            assert_close(
                stepper(stepper.rest(), u=force).position, ends[0].position, rtol=0, atol=0
            )


def held(scene):
    """What the supports of a scene hold."""
    return [(s.node, s.position, s.rotation, s.displacement, s.turn) for s in scene.supports]


def test_replace_finds_the_supports_afresh():
    """A root spring frees a clamp that nobody asked for, and gives it back; a root's motion goes
    and changes with the root.
    """
    clamped = tb.Scene(BEAM)
    spring = tb.RootSpring((torch.full((3,), 1e3), torch.full((3,), 10.0)))
    sprung = replace(clamped, effects=[spring])
    assert (
        held(clamped) == held(replace(sprung, effects=[])) == [(0, "xyz", "xyz", None, None)]
        and held(sprung) == []
    )
    moved = tb.RootMotion(displacement=lambda t: t.expand(3))
    other = tb.RootMotion(displacement=lambda t: -t.expand(3))
    scene = replace(clamped, root=moved)
    assert scene.supports[0].displacement is moved.displacement
    assert replace(scene, root=other).supports[0].displacement is other.displacement
    assert held(replace(scene, root=None)) == held(clamped)
    propped = tb.Scene(BEAM, supports=(tb.Support(0), tb.Support(-1, rotation="")))
    longer = replace(propped, beam=tb.Beam.straight(2.0, 5, SECTION))
    assert [s.node for s in propped.supports] == [0, 2] and [s.node for s in longer.supports] == [
        0,
        5,
    ]
    assert held(replace(propped, plane="xz", small=False)) == held(propped)


def test_a_clamp_moves_in_every_form():
    """A motion given by the clamp itself is that of the same `RootMotion`, in the mixed forms
    too.
    """

    def place(t):
        return torch.stack((torch.zeros_like(t), torch.zeros_like(t), t * t))

    t = torch.tensor([0.0, 0.02])
    for form, how in FORMS.items():
        ends = [
            tb.simulate(tb.Scene(BEAM, **held), t, form=form, **how).state[-1].position
            for held in (
                dict(root=tb.RootMotion(displacement=place)),
                dict(supports=tb.Support(0, displacement=place)),
            )
        ]
        assert_close(ends[1], ends[0], rtol=0, atol=0)
        assert_close(ends[0][0, 2], t[-1] ** 2, rtol=0, atol=1e-12)


def test_single_precision_is_asked_for():
    """By a keyword, which all that is made of the scene keeps; a float32 beam alone does not."""
    of = tb.Section.from_stiffness(
        EA=torch.tensor(10.0, dtype=torch.float32), GA=4.0, GJ=0.5, EI=1.0, mass=0.3
    )
    beam = tb.Beam.straight(torch.tensor(1.0, dtype=torch.float32), 2, of)
    effects = [tb.TipLoad(force=torch.tensor([0, 0, 0.1], dtype=torch.float32)), tb.Damping(0.1)]
    assert tb.Scene(beam, effects).dtype == torch.float64 == beam.nodes.dtype
    single = tb.Scene(beam, effects, dtype=torch.float32)
    again = replace(single, supports=[tb.Support(0, rotation="")], plane="xz")
    for scene in (single, again, copy.deepcopy(single), pickle.loads(pickle.dumps(single))):
        kinds = {x.value.dtype for x in leaves(scene) if isinstance(x.value, torch.Tensor)}
        assert scene.dtype == torch.float32 and kinds == {torch.float32}
    assert tb.equilibrium(single).position.dtype == torch.float32
    assert single.to(torch.float64).dtype == replace(single, dtype=None).dtype == torch.float64
    with pytest.raises(ValueError, match=r"torch\.float16 was given; torch\.float32 or"):
        tb.Scene(beam, dtype=torch.float16)


def test_root_state_and_views():
    """rest: undeformed, at rest, batched; node(-1) is the tip; a state survives clone, detach and
    torch.save.
    """
    state = tb.rest(tb.Scene(BEAM), batch_shape=(5,))
    assert (
        state.position.shape == (5, 3, 3)
        and state.batch_shape == (5,)
        and state.status.tolist() == [0] * 5
    )
    assert_close(state.tip.position, torch.tensor([1.0, 0, 0]).expand(5, 3))
    assert_close(state.tip.rotation, torch.eye(3).expand(5, 3, 3))
    assert_close(state.node(1).position, state.nodes[:, 1])
    assert_close(state.clone().detach().position, state.position)


def test_state_survives_a_file(tmp_path):
    state = tb.equilibrium(tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, 0.1))]))
    torch.save(state, tmp_path / "state.pt")
    again = torch.load(tmp_path / "state.pt")
    assert_close(again.position, state.position, rtol=0, atol=0)
    assert_close(again.root.force, state.root.force, rtol=0, atol=0)


@pytest.mark.parametrize(
    "effect",
    [
        tb.Spring(-1, 3.0, (0.5, 0.3, 0.2), damping=0.8),
        tb.Spring(-1, 3.0, (0.5, 0.3, 0.2), length=0.1),
        tb.Spring(-1, 3.0, (1.0, 0, 0.5)),
        tb.Drag(3.0, 0.1, flow=lambda x, t: x),
        tb.Drag(3.0, 0.1, added_mass=1.0),
    ],
)
def test_an_effect_of_a_scene_made_again_is_the_same_effect(effect):
    """`dataclasses.replace` of nothing, after the scene has made tensors of its numbers: what was
    absent stays absent.
    """
    section = tb.Section.from_stiffness(EA=2e3, GA=1e3, GJ=0.8, EI=1.0, mass=0.5, inertia=0.03)
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [effect])
    (bound,) = scene.effects
    again = replace(bound)
    assert (again.depends, again.conservative) == (bound.depends, bound.conservative)
    start = tb.State.from_nodes(scene, scene.beam.nodes, velocity=scene.beam.nodes[:, [2, 1, 0]])
    tips = [
        tb.simulate(replace(scene, effects=e), [0.0, 0.1, 0.2], start, step=0.05).tip.position
        for e in ([bound], [again])
    ]
    assert torch.equal(*tips)
