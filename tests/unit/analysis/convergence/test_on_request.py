"""Accuracy on request: simulate, equilibrium and modes on meshes of their own choice."""

import inspect

import numpy as np
import pytest
import torch

import torchbeam as tb
from torchbeam.analysis.convergence import on_request
from torchbeam.analysis.convergence.finer import finer
from torchbeam.analysis.convergence.on_request import shape
from torchbeam.analysis.convergence.reading import Reader
from torchbeam.statics import equilibrium as statics

T = torch.linspace(0, 0.5, 11)


@pytest.fixture(autouse=True)
def searches(monkeypatch):
    """Numbers of settings tried by each search, of few kinds; none is known from before."""
    monkeypatch.setattr(on_request, "_CHOICES", {})
    made, converge = [], on_request.converge

    def counted(*args, **options):
        best = converge(*args, elements=["linear"], methods=["midpoint"], **options)
        made.append(len(best.table))
        return best

    monkeypatch.setattr(on_request, "converge", counted)
    return made


def strip(EI=1.0, force=1.0, n=2):
    section = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=EI, mass=0.2)
    beam = tb.Beam.straight(1.0, n, section)
    return tb.Scene(beam, [tb.TipLoad(force=(0, 0, force)), tb.Damping(0.01)], plane="xz")


def test_equilibrium_to_an_accuracy(searches):
    """Within what is asked of elements of order 2; searched once for scenes like it, again where
    the load is three times as large; with the derivative of the chosen mesh.
    """
    for EI in (1.0, 1.2):
        state = tb.equilibrium(strip(EI), accuracy=1e-2)
        fine = tb.equilibrium(tb.remesh(strip(EI), 16, order=2))
        error = (state.tip.position - fine.tip.position).norm()
        assert error <= 1e-2 and state.position.shape[-2] < fine.position.shape[-2]
    assert len(searches) == 1
    tb.equilibrium(strip(force=3.0), accuracy=1e-2)
    tb.equilibrium(strip(), accuracy=2e-2)
    assert len(searches) == 3
    EI = torch.tensor(1.0, requires_grad=True)
    tb.equilibrium(strip(EI), accuracy=1e-2).tip.position[2].backward()
    assert len(searches) == 3 and EI.grad < -0.1


def test_a_model_of_identify_names_an_accuracy(searches):
    """In place of a mesh: the stiffness behind what a much finer mesh bends to; two elements find
    another one. Searched once for each size of batch.
    """
    data = tb.equilibrium(strip(1.1, n=64)).tip.position

    def found(**options):
        def model(EI):
            return tb.equilibrium(strip(EI[:, 0]), **options).tip.position

        return tb.identify(model, data, torch.tensor([1.0]), log=True).theta.item()

    assert found(accuracy=1e-4) == pytest.approx(1.1, rel=1e-3)
    assert found() != pytest.approx(1.1, rel=1e-2)
    assert len(searches) <= 3


def test_inputs_are_a_part_of_the_scene(searches):
    beam = strip().beam
    scene = tb.Scene(beam, [tb.TipLoad(force=tb.Input("f", 3))], plane="xz")
    for force, count in ((1.0, 1), (1.2, 1), (3.0, 2)):
        tb.equilibrium(scene, inputs={"f": torch.tensor([0, 0, force])}, accuracy=1e-2)
        assert len(searches) == count


def test_modes_to_an_accuracy():
    modes = tb.modes(strip(), count=2, accuracy=1e-2)
    fine = tb.modes(tb.remesh(strip(), 16, order=2), count=2).eigenvalue.abs()
    assert (modes.eigenvalue.abs() / fine - 1).abs().max() < 1e-2


@pytest.mark.steps
def test_motion_to_an_accuracy(searches):
    """From an equilibrium of the mesh that is chosen; what describe says; what converge gave."""
    scene = strip()

    def start(own):
        return tb.equilibrium(tb.Scene(own.beam, [tb.TipLoad(force=(0, 0, 0.8))], plane="xz"))

    solution = tb.simulate(scene, T, start, accuracy=2e-2, throw=True)
    fine = tb.remesh(scene, 8, order=2)
    limit = tb.simulate(fine, T, start(fine), step=0.002)
    error = (solution.tip.position - limit.tip.position).norm()
    assert error <= 2e-2 * (limit.tip.position - limit.tip.position[0]).norm()
    (choice,) = on_request.choices_of(scene)
    assert str(choice) in str(tb.describe(scene)) and not on_request.choices_of(strip(3.0))
    best = tb.converge(
        scene, T, tb.sensors.TipPosition(), 5e-2, elements=["linear"], methods=["midpoint"]
    )
    solution = tb.simulate(scene, T, accuracy=best)
    assert torch.equal(solution.tip.position, best.solution.tip.position) and len(searches) == 1


def test_what_is_missed_is_said(searches, monkeypatch):
    """Each time, not only by the search."""
    few = on_request.converge
    monkeypatch.setattr(on_request, "converge", lambda *a, **o: few(*a, **o, most_elements=4))
    for _ in range(2):
        with pytest.warns(RuntimeWarning, match="accuracy = 1e-07 was not reached"):
            tb.equilibrium(strip(), accuracy=1e-7)
    assert len(searches) == 1


def test_inputs_held_over_intervals(searches):
    """The same as held throughout; an unknown keyword is Python's to say."""
    scene = tb.Scene(strip().beam, [tb.TipLoad(force=tb.Input("f", 3))], plane="xz")
    held = tb.PerInterval(torch.tensor([0.0, 0, 1.0]).expand(len(T) - 1, 3))
    moved = tb.simulate(scene, T, inputs={"f": held}, accuracy=0.2).tip.position
    fine = tb.simulate(tb.remesh(strip(), 8), T, step=0.025).tip.position
    assert searches and (moved - fine).abs().max() < 0.2 * fine[:, 2].abs().max()
    with pytest.raises(TypeError, match="unexpected keyword argument 'stepp'"):
        tb.simulate(scene, T, stepp=0.1, accuracy=0.1)


def test_what_has_no_hash_is_searched_each_time(searches):
    scene = tb.Scene(strip().beam, [tb.TipLoad(force=tb.Input("f", 3))], plane="xz")
    for _ in range(2):
        tb.equilibrium(scene, inputs={"f": np.array([0, 0, 1.0])}, accuracy=1e-2)
    assert len(searches) == 2


def test_what_stays_is_measured_by_its_size():
    """Rounding about a place is no motion to be resolved."""
    still = torch.ones(4, 3) + 1e-12 * torch.rand(4, 3)
    reader = Reader(lambda solution: still, strip())
    assert reader.errors(still, torch.ones(4, 3), 4) < 1e-11


def test_bad_input():
    for call, sentence in (
        (lambda: tb.simulate(strip(), T, accuracy=1e-2, step=0.1), "step was given with accuracy"),
        (
            lambda: tb.simulate(strip(), T, tb.rest(strip()), accuracy=0.1),
            "tb.equilibrium, is wanted",
        ),
        (lambda: tb.simulate(strip(), T, accuracy=-1.0), "positive"),
        (lambda: tb.equilibrium(strip(), accuracy=1.0), "relative error below 1"),
        (
            lambda: tb.simulate(strip(), T, accuracy=tb.converge(strip(), None, shape, 0.1)),
            "one with t, which chooses a step too",
        ),
        (lambda: tb.equilibrium(3, accuracy=0.1), "torchbeam.Scene is wanted"),
        (
            lambda: tb.equilibrium(strip(), initial=tb.rest(strip()), accuracy=0.1),
            "initial was given",
        ),
        (lambda: tb.modes(strip(), tb.rest(strip()), accuracy=0.1), "state was given"),
        (lambda: statics.equilibrium(strip(), accuracy=0.1), "torchbeam.equilibrium takes it"),
        (
            lambda: torch.func.vmap(lambda EI: tb.equilibrium(strip(EI), accuracy=0.1).position)(
                torch.ones(2)
            ),
            "torch.func",
        ),
    ):
        with pytest.raises(ValueError, match=sentence):
            call()


def test_signatures_show_it():
    for call in (tb.simulate, tb.equilibrium, tb.modes):
        assert "accuracy" in inspect.signature(call).parameters and "accuracy" in call.__doc__


@pytest.mark.parametrize("beside", [{}, {"accuracy": 1e-2}], ids=["finer", "accuracy"])
def test_more_than_simulate_takes_is_refused_where_it_runs_otherwise(beside):
    for given, more in (((None, "midpoint", 1e-3), {}), ((None,), {"initial": None})):
        with finer(), pytest.raises(TypeError):
            tb.simulate(strip(), T, *given, **more, **beside)
