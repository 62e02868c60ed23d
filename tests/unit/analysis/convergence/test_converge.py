"""converge: error, cost and sentences of what it chooses."""

import csv
import math
from dataclasses import replace

import pytest
import torch

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.analysis.convergence.law import ErrorLaw, remaining
from torchbeam.analysis.convergence.reading import Reader, on_mesh
from torchbeam.analysis.convergence.search import Search
from torchbeam.analysis.convergence.setting import Setting
from torchbeam.analysis.convergence.trials import TrialRuns

pytestmark = pytest.mark.steps
SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
T = torch.linspace(0, 0.5, 11)
FEW = dict(elements=["linear", "order 2"], methods=["midpoint"])  # that are compiled anyway


def strip(*effects, **options):
    beam = tb.Beam.straight(1.0, 4, SECTION)
    return tb.Scene(beam, [tb.TipLoad(force=(0, 0, 1.0)), *effects], plane="xz", **options)


@pytest.fixture(scope="module")
def best():
    return tb.converge(strip(tb.Damping(0.01)), T, tb.sensors.TipPosition(), 1e-2, **FEW)


def test_the_error_is_within_what_is_said(best):
    """Against elements of order 2 with four times the nodes and a sixth of the step."""
    fine = tb.remesh(best.scene, 2 * best.settings.intervals, order=2, linked=False)
    limit = tb.simulate(fine, T, step=best.settings.step / 6)
    paths = [solution.tip.position for solution in (best.solution, limit)]
    moved = (paths[1] - paths[1][0]).norm()
    assert best.converged and best.error <= 1e-2
    assert (paths[0] - paths[1]).norm() / moved <= best.error


def test_what_was_tried_is_told(best, tmp_path):
    """The table, its file, the code: which gives the same solution, with gradient."""
    assert [tried.setting for tried in best.table if tried.chosen] == [best.settings]
    assert f"estimated error {best.error:.1e}" in str(best) and "->" in str(best)
    best.csv(tmp_path / "tried.csv")
    head, *rows = csv.reader((tmp_path / "tried.csv").read_text().splitlines())
    assert [row[head.index("steps")] for row in rows] == [str(tried.steps) for tried in best.table]
    names = {"tb": tb, "scene": strip(tb.Damping(0.01)), "t": T}
    exec(best.code, names)
    assert torch.equal(names["solution"].tip.position, best.solution.tip.position)
    axes = tb.plot.tried(best)
    assert axes.get_xscale() == "log" and axes.get_legend_handles_labels()[1]


def test_a_function_makes_the_scene():
    """Of a structure, whose beams no mesh is made anew of: a function makes it, without linked
    elements, which are not refused in silence.
    """

    def structure(elements, order):
        beam = tb.Beam.straight(1.0, elements, SECTION, order=order)
        load = tb.PointLoad(("arm", -1), force=(0, 0, 1.0))
        return tb.Scene({"arm": beam}, [load], supports=[tb.Support(("arm", 0))])

    def frequencies(scene):
        return tb.modes(scene, count=2)

    best = tb.converge(structure, None, lambda m: m.frequency, 3e-2, solve=frequencies)
    assert best.converged and "Without linked" in str(best)


def test_statics_and_modes():
    """Without t, by the equilibrium or by any function of the scene."""
    scene = strip()
    best = tb.converge(scene, None, tb.sensors.NodePosition(2), 1e-2, elements=["linear"])
    assert best.converged and best.options == {}
    modal = tb.converge(
        scene, None, lambda m: m.frequency, 1e-3, solve=lambda s: tb.modes(s, count=2)
    )
    limit = tb.modes(tb.remesh(scene, 24, order=2), count=2).frequency
    error = ((modal.solution.frequency - limit).norm() / limit.norm()).item()
    assert modal.converged and error <= modal.error


def test_meshes_have_a_node_where_a_sensor_is():
    """Of four elements at the first node: multiples of four, with no element left out for another
    number; and where sensors are made of others.
    """
    at = tb.sensors.NodePosition(1)
    both = tb.sensors.Stack([at[2], tb.sensors.TipPosition()])
    for read in (at, both):
        best = tb.converge(strip(), None, read, 1e-3)
        assert best.converged and "Without" not in str(best)
        assert all(tried.setting.elements % 4 == 0 for tried in best.table)


def test_what_vanishes_is_known():
    """The deflection across the plane, zero on every mesh, has no error; what is no number has."""
    scene = strip(tb.Damping(0.01))
    best = tb.converge(scene, T, lambda solution: solution.tip.position[..., 1], 1e-2, **FEW)
    assert best.converged and best.error == 0
    reader = Reader(None, scene)
    nothing = torch.full((3,), math.nan)
    assert reader.errors(nothing, nothing, None) == math.inf


def test_what_cannot_be_reached_is_said():
    """Too few elements and steps are allowed: the sentences name what is missing."""
    best = tb.converge(strip(), T, tb.sensors.TipVelocity(), 1e-4, most_elements=8, most_steps=40)
    assert not best.converged
    assert "were wanted" in str(best) and "are allowed" in str(best)


def test_a_batch_has_one_setting_by_its_worst_sample():
    """Of a slow and a fast strip the fast one wants the shorter step, and nine tenths of the
    samples may be asked for alone.
    """
    beam = tb.Beam.straight(1.0, 4, SECTION)
    force = torch.tensor([[0.0, 0, 0.01]] * 9 + [[0, 0, 4.0]])
    scene = tb.Scene(beam, [tb.TipLoad(force=force), tb.Damping(0.01)], plane="xz")
    read, steps = tb.sensors.TipPosition(), dict(methods=["midpoint"], elements=["order 2"])
    all_, most = (tb.converge(scene, T, read, 3e-3, share=x, **steps) for x in (1.0, 0.9))
    assert all_.converged and most.converged
    assert len(all_.solution.t) == len(T) and all_.solution.tip.position.shape == (11, 10, 3)
    reader = Reader(read, scene)
    fine = tb.simulate(tb.remesh(scene, 16, order=2), T, step=2e-3).tip.position
    errors = reader.errors(all_.solution.tip.position, fine, len(T))
    assert errors.shape == (10,) and errors.max() <= 3e-3


def test_sensors_keep_their_places():
    scene = strip()
    fine = tb.remesh(scene, 6, order=2)
    assert on_mesh(tb.sensors.NodePosition(2), scene, fine).node == 6
    strain = on_mesh(tb.sensors.Strain(0.25, scene)[:2], scene, fine)
    assert strain.of.beam is fine.beam
    with pytest.raises(ValueError, match="one at a station s is wanted"):
        on_mesh(tb.sensors.Strain(element=1, beam=scene), scene, fine)


def test_laws_of_errors():
    """Changes of e = 3 n^-2: errors are 4/3 of them between, beyond and below the levels; of one
    level the expected order holds, but its own error is told as by order 1; no faster than the
    element's order. A low order leaves much behind a small change.
    """
    law = ErrorLaw(4.0, 2.0, {n: 0.75 * 3 * n**-2.0 for n in (4, 8)})
    for n in (2, 4, 6, 8, 20):
        assert law.predicted(n) == pytest.approx(3 * n**-2.0)
    assert law.order() == pytest.approx(2)
    one = ErrorLaw(4.0, 3.0, {4: 0.75})
    assert one.order() is None and one.error(4) == one.predicted(4) == 1.5
    assert one.predicted(8) == pytest.approx(1 / 8)
    assert ErrorLaw(2.0, 2.0, {4: 1.0, 8: 1e-3}).predicted(16) == pytest.approx(4 / 3 * 0.25e-3)
    assert ErrorLaw(2.0, 2.0).predicted(4) == math.inf
    slow = ErrorLaw(4.0, 2.0, {n: (1 - 2**-0.5) * n**-0.5 for n in (4, 16)})  # e = n^-1/2
    assert slow.error(16) == pytest.approx(1 / 4) and slow.predicted(64) == pytest.approx(1 / 8)
    assert ErrorLaw(2.0, 2.0, {4: 0.0, 8: 0.0}).predicted(16) == 0 and remaining(0.75, 2.0) == 1.0


def search_of(scene, rtol, **change):
    """A search by what runs would cost, that does not depend on the machine; change(setting): of
    the fields of a trial.
    """
    trials = TrialRuns(
        lambda setting: tb.remesh(scene, **setting.mesh), Reader(tb.sensors.TipPosition(), scene),
        T, None, 1.0, {},
    )  # fmt: skip
    run = trials._run

    def counted(setting):
        changed = {name: torch.tensor(of(setting)) for name, of in change.items()}
        return replace(run(setting), seconds=1e-6 * trials.work(setting), **changed)

    trials._run = counted
    return Search(trials, rtol, 1, 0.05, ["linear"], ["midpoint"], (64, 2000))


def test_runs_serve_again():
    """A step's error that was told on another mesh is not told anew: of what is chosen the run
    with half the step was not made, that with twice the elements was.
    """
    search = search_of(strip(tb.Damping(0.01)), 2e-2)
    best = search.run()
    fine = replace(best.setting, elements=2 * best.setting.elements)
    half = replace(best.setting, step=best.setting.step / 2)
    made = search.trials.made
    assert best.error <= 2e-2 and fine in made and half not in made and len(made) == 5
    _, (coarse, level) = best.levels
    assert coarse.elements == level.elements > best.setting.elements and level.step == half.step


def test_a_method_that_is_refused_is_left_out():
    """midpoint4 does not take a strong MassDamping: the reason is told, midpoint chosen."""
    scene = strip(tb.MassDamping(300.0), tb.Damping(0.01))
    steps = dict(elements=["linear"], methods=["midpoint4", "midpoint"])
    best = tb.converge(scene, T, tb.sensors.TipPosition(), 1e-4, **steps)
    assert best.settings.method == "midpoint" and "Without midpoint4: " in str(best)
    with pytest.raises(ValueError, match="given to steps of"):
        tb.converge(scene, T, tb.sensors.TipPosition(), 1e-2, methods=["midpoint4"])


def test_failed_runs_ask_for_finer_ones():
    """Where neither fewer than eight elements nor steps above 10 ms run."""
    search = search_of(
        strip(), 1e-2, failed=lambda setting: setting.elements < 8 or setting.step > 0.01
    )
    best = search.run()
    assert best.error <= 1e-2 and best.setting.elements >= 8 and best.setting.step <= 0.01
    assert search.failed and math.isinf(search.checked[0].error)


@refusals(
    (dict(rtol=0.0), "rtol = 0"),
    (dict(elements=["cubic"]), "one of elements"),
    (dict(methods=[]), "one of methods"),
    (dict(rtol=1.0), "a relative error below 1 is wanted"),
    (dict(solve=tb.equilibrium), "t and solve were given"),
    (dict(t=None, solve=lambda scene: None), "solve gave None"),
    (dict(t=None, read=lambda state: None), "read gave None"),
    (dict(read=lambda solution: solution.tip.position[..., :0]), "without a number"),
    (dict(read=lambda solution: solution.nodes), "one that no mesh changes is wanted"),
    (dict(read=lambda solution: solution.tip.position[0, 0] > 0), "real floating numbers"),
)
def test_refusals(given):
    given = {"t": T, "read": tb.sensors.TipPosition(), **given}
    tb.converge(strip(tb.Damping(0.01)), **FEW | given)


@pytest.mark.parametrize(
    "read, alike",
    [
        pytest.param(
            lambda x: torch.arange(1, 12) * x.tip.position[-1, 2],
            lambda x: x.tip.position[-1, 2],
            id="numbers, as many as instants",
        ),
        pytest.param(lambda x: x.tip.position[:, 2], tb.sensors.TipPosition()[2], id="a history"),
        pytest.param(
            lambda x: x.tip.position[:, 2] + torch.zeros(11),
            tb.sensors.TipPosition()[2],
            id="a history beside one that was measured",
        ),
        pytest.param(lambda x: x.energy.work, lambda x: x.energy.work[:, None], id="work"),
    ],
)
def test_numbers_are_no_history_for_being_as_many_as_instants(read, alike):
    """Their error is that of one of them, as all are multiples of it; a history's that of a
    sensor's.
    """
    scene, errors = strip(tb.Damping(0.01)), []
    settings = [Setting("linear", elements, "midpoint", 0.05) for elements in (4, 8)]
    for one in (read, alike):
        trials = TrialRuns(
            lambda at: tb.remesh(scene, **at.mesh), Reader(one, scene), T, None, 1.0, {}
        )
        errors.append(trials.difference(*settings))
    assert errors[0] > 1e-5
    assert errors[0] == pytest.approx(errors[1], rel=1e-9)
