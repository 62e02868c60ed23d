"""save and load: a run that goes on from a file is the run; a file of something else is refused."""

import math
import os
import pickle
from copy import copy

import pytest
import torch

import torchbeam as tb

SECTION = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)
BEAM = tb.Beam.straight(1.0, 3, SECTION)
FORCE = torch.tensor([[0.0, 0, 1], [0, 0.5, 2]])
WEIGHT = tb.Gravity((0, 0, -9.81))
SCENES = {
    "batch": lambda: tb.Scene(BEAM, [tb.TipLoad(force=FORCE), tb.Damping(0.002)]),
    "contact": lambda: tb.Scene(
        BEAM,
        [
            WEIGHT,
            tb.Contact(
                tb.Plane((0, 0, -0.02), (0, 0, 1)),
                thickness=0.002,
                force=200.0,
                friction=0.3,
                slip_speed=0.01,
            ),
        ],
    ),
    "structure": lambda: tb.Scene(
        {"a": BEAM, "b": tb.Beam.straight(0.5, 2, SECTION, root=(1.0, 0, 0))},
        [WEIGHT],
        joints=[tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0))],
        supports=[tb.Support(("a", 0))],
    ),
}
T = torch.linspace(0, 0.08, 9)
WAYS = [{}, {"conserve": True}, {"method": "generalized_alpha"}, {"engine": "eager"}]


def same(a, b, names=("position", "rotation", "velocity", "spin", "stress", "reaction")):
    return all(torch.equal(getattr(a, name), getattr(b, name)) for name in names)


@pytest.mark.parametrize(
    "name, how",
    [("batch", how) for how in WAYS] + [("contact", {}), ("structure", {}), ("structure", WAYS[2])],
)
def test_a_run_goes_on_from_a_file_as_if_never_interrupted(name, how, tmp_path):
    """To the bit, in the same engine."""
    scene = SCENES[name]()
    whole = tb.simulate(scene, T, step=0.01, **how)
    first = tb.simulate(scene, T[:5], step=0.01, **how)
    path = tb.save(first.state[-1], tmp_path / "state.pt", scene=scene)
    start = tb.load(path, scene=SCENES[name]())  # made anew, as another process would
    rest = tb.simulate(scene, T[4:], start, step=0.01, **how)
    assert type(start) is type(first.state[-1]) and same(rest.state, whole.state[4:])


@pytest.mark.parametrize("how", WAYS)
@pytest.mark.parametrize(
    "plane, up, to_the_bit",
    [("xy", None, True), ("xz", None, True), ("xy", (0, 1, 0), False), ("xz", (0, 1, 0), False)],
)
def test_a_run_in_a_plane_goes_on_from_a_file(plane, up, to_the_bit, how, tmp_path):
    """To the bit where y of the sections stands along the normal of xz, and z along that of xy, as
    they do without `up=`: turned by a quarter, the plane's cosine and sine are mixed in the
    quaternion, from which they come back to rounding.
    """
    soft = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=0.4, EI=0.5, mass=0.2, inertia=1e-4)
    beam = tb.Beam.straight(1.0, 4, soft, up=up)
    force = (0.5, 0.5, 0) if plane == "xy" else (0.5, 0, 0.5)
    scene = tb.Scene(beam, [tb.TipLoad(force=force), tb.Damping(0.01)], plane=plane)
    T = torch.arange(9) / 16
    whole = tb.simulate(scene, T, step=1 / 64, **how)
    assert (whole.status == 0).all() and (
        whole.tip.position[-1] - whole.tip.position[0]
    ).norm() > 0.1
    path = tb.save(whole.state[4], tmp_path / "state.pt", scene=scene)
    rest = tb.simulate(scene, T[4:], tb.load(path, scene=scene), step=1 / 64, **how)
    assert same(rest.state, whole.state[4:]) or not to_the_bit
    torch.testing.assert_close(rest.tip.position, whole.tip.position[4:], rtol=0, atol=1e-12)


@pytest.mark.parametrize("how", WAYS)
def test_a_run_goes_on_from_any_instant(how):
    """To the bit, though work is counted from where a run starts."""
    scene = SCENES["batch"]()
    whole = tb.simulate(scene, T, step=0.01, **how)
    for k in range(1, len(T) - 1):
        rest = tb.simulate(scene, T[k:], whole.state[k], step=0.01, **how)
        assert same(rest.state, whole.state[k:])


@pytest.mark.parametrize("form", ["minimal", "block_rate"])
def test_states_of_other_forms(form, tmp_path):
    soft = tb.Section.from_stiffness(EA=10.0, GA=4.0, GJ=0.5, EI=1.0, mass=0.3, inertia=0.01)
    scene = tb.Scene(tb.Beam.straight(1.0, 2, soft), [tb.TipLoad(force=(0, 0, 0.1))])
    solution = tb.simulate(scene, [0.0, 0.1], form=form, rtol=1e-3, atol=1e-3)
    again = tb.load(tb.save(solution, tmp_path / "a.pt", scene=scene), scene=scene)
    assert same(again.state, solution.state, ("position", "rotation", "velocity"))


def test_a_solution_is_all_there(tmp_path):
    """Numbers, energies, statistics, events; without gradient."""
    force = FORCE.clone().requires_grad_()
    scene = tb.Scene(BEAM, [tb.TipLoad(force=force)])
    solution = tb.simulate(
        scene, T, rtol=1e-2, events=[lambda state: state.tip.position[..., 2] - 0.01]
    )
    again = tb.load(tb.save(solution, tmp_path / "run.pt"))
    assert same(again.state, solution.state) and torch.equal(again.status, solution.status)
    assert all(map(torch.equal, again.energy, solution.energy))
    assert torch.equal(again.event.t, solution.event.t)
    assert same(again.event.state, solution.event.state)
    assert again.stats.engine == solution.stats.engine
    assert torch.equal(again.stats.lengths, solution.stats.lengths)
    assert not again.state.position.requires_grad and solution.state.position.requires_grad


def test_a_state_is_saved_without_the_trajectory_that_it_is_of(tmp_path):
    scene = SCENES["batch"]()
    many = tb.simulate(scene, torch.linspace(0, 0.2, 21), step=0.01).state
    assert os.path.getsize(tb.save(many[-1], tmp_path / "one.pt")) < 0.2 * os.path.getsize(
        tb.save(tb.simulate(scene, torch.linspace(0, 0.2, 21), step=0.01), tmp_path / "all.pt")
    )


def test_another_scene_is_told(tmp_path):
    """By what differs, down to a number that a function closes over; by shape where the file does
    not know its scene.
    """

    def pushed(size, beam=BEAM, **more):
        return tb.Scene(beam, [tb.TipLoad(force=lambda t: size * FORCE * t)], **more)

    scene = pushed(1.0)
    state = tb.rest(scene, batch_shape=(2,))
    path = tb.save(state, tmp_path / "state.pt", scene=scene)
    assert same(tb.load(path, scene=pushed(1.0)), state)
    with pytest.raises(ValueError, match="another scene: its effects differ"):
        tb.load(path, scene=pushed(2.0))
    longer = tb.Beam.straight(1.1, 3, SECTION)
    with pytest.raises(ValueError, match="its beam and effects and plane differ"):
        tb.load(path, scene=pushed(2.0, longer, plane="xz"))
    assert same(tb.load(path), state)
    for given in (dict(path=path), dict(path=tb.save(state, tmp_path / "bare.pt"))):
        with pytest.raises(ValueError, match="4 nodes was given; the beam has 5"):
            tb.load(**given, scene=tb.Scene(tb.Beam.straight(1.0, 4, SECTION)))
    with pytest.raises(ValueError, match=r"a state with a, b was given; the scene has no parts"):
        tb.save(
            tb.rest(SCENES["structure"]()),
            tmp_path / "x.pt",
            scene=tb.Scene(tb.Beam.straight(1.0, 6, SECTION)),
        )


class Harm:
    """What pickle would run."""

    def __reduce__(self):
        return print, ("run",)


def test_what_is_no_saved_state_is_refused(tmp_path, capsys):
    path = tmp_path / "x.pt"
    for content in (pickle.dumps(Harm(), 2), b"", b"text"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="no saved state or solution of this version"):
            tb.load(path)
    for what in ({"torchbeam state": math.inf}, torch.ones(3), Harm()):
        torch.save(what, path)
        with pytest.raises(ValueError, match="no saved state or solution of this version"):
            tb.load(path)
    assert capsys.readouterr().out == ""
    rest = tb.rest(SCENES["batch"]())
    less, more = copy(rest), copy(rest)
    del vars(less)["position"]
    vars(more)["later"] = torch.ones(2)
    for what in (None, 3, torch.ones(3), less, more):
        torch.save({"torchbeam state": 1, "what": what, "digests": None}, path)
        for scene in (None, SCENES["batch"]()):
            with pytest.raises(ValueError, match=r"no (saved )?state or solution of this version"):
                tb.load(path, scene=scene)
    for content in ({}, {"what": rest, "digests": 3}):
        torch.save({"torchbeam state": 1, **content}, path)
        with pytest.raises(ValueError, match=r"no (saved )?state or solution of this version"):
            tb.load(path)
    torch.save({"torchbeam state": 1, "what": rest, "digests": {"beam": "another"}}, path)
    with pytest.raises(ValueError, match="its beam and effects and frame"):
        tb.load(path, scene=SCENES["batch"]())
    with pytest.raises(ValueError, match="cannot be read"):
        tb.load(tmp_path / "none.pt")
    with pytest.raises(ValueError, match="Scene was given to save"):
        tb.save(SCENES["batch"](), path)


def test_a_run_in_inference_mode_is_the_run_and_goes_on_outside(tmp_path):
    """A state at rest holds views of the scene's tensors beside tensors made in that mode."""
    scene = tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, 1.0))])
    with torch.inference_mode():
        solution = tb.simulate(scene, T, step=0.01)
        path = tb.save(solution.state[4], tmp_path / "state.pt", scene=scene)
    assert same(tb.simulate(scene, T, step=0.01).state, solution.state)
    start = tb.load(path, scene=scene)
    assert same(tb.simulate(scene, T[4:], start, step=0.01).state, solution.state[4:])


def test_within_a_transform_there_is_nothing_to_save(tmp_path):
    def one(force):
        state = tb.equilibrium(tb.Scene(BEAM, [tb.TipLoad(force=force)]))
        tb.save(state, tmp_path / "state.pt")
        return state.position

    with pytest.raises(ValueError, match="within a transform"):
        torch.func.vmap(one)(FORCE)
