"""A state remembers how its beam is shaped at rest: sensors of another beam refuse it, and a motion
of another beam that starts from it warns.
"""

import copy
import io
import warnings

import pytest
import torch

import torchbeam as tb

SECTION = tb.Section.from_stiffness(EA=1e3, GA=4e2, GJ=3.0, EI=(2.0, 5.0), mass=0.3, inertia=0.01)
FORCE = tb.TipLoad(force=(0, 0, 0.1))
BEAM = tb.Beam.straight(1.0, 4, SECTION)
BENT = tb.Beam.from_nodes([[0.0, 0, 0], [0.25, 0, 0], [0.5, 0, 0], [0.5, 0.25, 0], [0.5, 0.5, 0]],
                          SECTION)  # fmt: skip
OTHERS = {"longer": tb.Beam.straight(1.2, 4, SECTION), "bent": BENT}
ALONG = {
    "Strain": tb.sensors.Strain(0.3, BEAM),
    "Curvature": tb.sensors.Curvature(0.3, tb.Scene(BEAM)),
    "Gauge": tb.sensors.Gauge(element=1, beam=BEAM),
    "Stress": tb.sensors.Stress(0.3, BEAM),
    "Stack": tb.sensors.Stack([tb.sensors.Strain(0.3, BEAM)]),
}
SENSOR = ALONG["Curvature"]
ANOTHER = "a state of another beam was given"


def state(beam):
    return tb.equilibrium(tb.Scene(beam, [FORCE]), engine="eager")


@pytest.fixture(scope="module", params=OTHERS)
def other(request):
    return state(OTHERS[request.param])


@pytest.mark.parametrize("name", ALONG)
def test_a_state_of_another_beam_is_refused(name, other):
    with pytest.raises(ValueError, match=ANOTHER):
        ALONG[name](other)


def saved(state):
    file = io.BytesIO()
    torch.save(state, file)
    file.seek(0)
    return torch.load(file, weights_only=True)


@pytest.mark.parametrize("changed", [copy.deepcopy, saved, lambda x: x.detach(), lambda x: x[None]])
def test_whatever_was_done_to_it(changed, other):
    with pytest.raises(ValueError, match=ANOTHER):
        SENSOR(changed(other))


@pytest.mark.parametrize("solve", ["steps", "motion", "explicit motion", "observe"])
def test_after_a_motion(solve):
    scene = tb.Scene(OTHERS["longer"], [FORCE])
    if solve == "steps":
        reached = tb.Stepper(scene, 0.01, engine="eager")(tb.rest(scene))
    else:
        implicit = dict(step=1e-3, engine="eager")
        options = dict(method="euler") if solve == "explicit motion" else implicit
        solution = tb.simulate(scene, [0, 1e-6, 2e-6], **options)
        reached = solution.state
    with pytest.raises(ValueError, match=ANOTHER):
        tb.observe(solution, SENSOR, [1e-6]) if solve == "observe" else SENSOR(reached)


def test_what_reads_alike_is_taken():
    """Another place, another material, a beam made again; a sample of a batch."""
    expected = SENSOR(state(BEAM))
    again = tb.Beam.straight(1.0, 4, SECTION, root=(1.0, 2.0, 3.0), direction=(0, 1.0, 0))
    torch.testing.assert_close(SENSOR(state(again)), expected)
    stiff = tb.Beam.straight(1.0, 4, tb.Section.from_stiffness(EA=1e9, GA=1e9, GJ=1, EI=1, mass=1))
    SENSOR(state(stiff))
    batch = state(tb.Beam.straight(torch.tensor([1.2, 1.0]), 4, SECTION))
    torch.testing.assert_close(SENSOR(batch[1]), expected)
    merged = batch.where(torch.tensor([True, False]), state(BEAM))
    assert merged.rest_shape is None


def test_parts_of_a_structure():
    short, joint = tb.Beam.straight(0.5, 2, SECTION, root=(1.0, 0, 0)), tb.Weld(("a", -1), ("b", 0))
    scene = tb.Scene({"a": BEAM, "b": short}, joints=[joint], supports=[tb.Support(("a", 0))])
    rest = tb.rest(scene)
    tb.sensors.Strain(0.2, scene, on="b")(rest)
    tb.sensors.Strain(0.2, short, on="b")(rest)
    with pytest.raises(ValueError, match=ANOTHER):
        tb.sensors.Strain(0.2, tb.Beam.straight(0.6, 2, SECTION), on="b")(rest)


def test_a_start_of_another_beam_warns():
    scene = tb.Scene(OTHERS["longer"], [FORCE])
    stepper = tb.Stepper(scene, 0.01, engine="eager")
    with pytest.warns(UserWarning, match=f"{ANOTHER} to start from"):
        after = stepper(state(BEAM))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stepper(after)
        stepper(tb.State.from_nodes(scene, state(scene.beam).position))
        tb.equilibrium(scene, initial=state(BEAM))  # where a search begins is free
    with pytest.raises(ValueError, match=ANOTHER):
        SENSOR(after)
