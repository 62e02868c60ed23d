"""What public objects print as: a few short lines with sizes, batch axes, dtype and effects, never
a tensor.
"""

import math
from dataclasses import replace

import pytest
import torch

import torchbeam as tb
from torchbeam.core.summary import aligned

SECTION = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=(1.0, 2.0), mass=0.5, inertia=0.01)
FORCES = torch.linspace(0, 1, 7 * 3).reshape(7, 3)


def scene(**options):
    effects = [tb.TipLoad(force=FORCES), tb.Damping(0.01), tb.Drag(1.2, 0.01)]
    return tb.Scene(tb.Beam.straight(2.0, 4, SECTION), effects, **options)


def objects():
    one = scene()
    t = torch.linspace(0, 0.02, 3)
    solution = tb.simulate(one, t, step=0.01)
    rod = tb.Scene(one.beam, [tb.TipLoad(force=FORCES)])
    mixed = tb.simulate(rod, t, form="minimal")
    yield from (one, solution, solution.state, solution.state[-1], mixed, mixed.state)
    yield tb.block_rate(rod, tb.consistent_state(rod))
    yield tb.modes(rod)
    yield tb.linearize(rod)
    yield tb.path(tb.Scene(rod.beam, [tb.TipLoad(force=FORCES)]), steps=2)
    yield tb.critical_load(
        lambda P: tb.Scene(rod.beam, [tb.TipLoad(force=P[..., None] * FORCES)]), 1.0, points=2
    )


def few_lines(thing, *words):
    text = repr(thing)
    assert (
        len(text.splitlines()) <= 8
        and max(map(len, text.splitlines())) <= 120
        and "tensor" not in text
    ), text
    for word in words:
        assert word in text, (word, text)


def test_objects_of_a_batch_fit_a_screen():
    for thing in objects():
        few_lines(thing, f"{type(thing).__name__}(", "float64", "batch (")


def test_section_says_stiffness_and_mass():
    few_lines(SECTION, "EA 1000 N", "EI 1 and 2 N m^2", "mass 0.5 kg/m", "float64", "no batch axes")
    few_lines(
        tb.Section.from_stiffness(EA=math.inf, GA=math.inf, GJ=FORCES[:, 2] + 1, EI=1.0, mass=1.0),
        "EA inf",
        "inextensible and unshearable, no rotary inertia",
        "batch (7,)",
    )
    few_lines(SECTION.shifted(z=0.1), "coupled compliance", "centre of mass off the axis")
    single = tb.Scene(tb.Beam.straight(1.0, 2, SECTION), dtype=torch.float32)
    few_lines(single, "no batch axes, float32")


def test_beam_says_size_and_ends():
    few_lines(tb.Beam.straight(2.0, 1, SECTION), "1 element, 2 m long, 1 kg", "tip at (2, 0, 0) m")
    few_lines(tb.Beam.straight(FORCES[:, 2] + 1, 4, SECTION), "4 elements", "batch (7,)")
    few_lines(tb.Beam.arc(1.0, 1.0, 4, SECTION), "curved")


def test_scene_says_what_is_on():
    few_lines(scene(), "TipLoad at node 4, Damping, Drag", "clamp of node 0", "in 3D", "batch (7,)")
    few_lines(
        scene(plane="xy", supports=(tb.Support(0), tb.Support(-1, rotation=""))),
        "plane 'xy'",
        "support of node 4",
    )
    few_lines(
        tb.Scene(scene().beam, supports=(), small=True),
        "effects: none",
        "free",
        "small displacements",
    )
    few_lines(scene(frame=tb.Frame(angular_velocity=(0.0, 0, 1))), "frame a moves")


def test_status_of_each_sample_is_counted():
    state = tb.rest(scene())
    few_lines(state, "5 nodes", "t = 0 s", "status 0")
    failed = torch.zeros(7, dtype=torch.long)
    failed[2] = 1
    few_lines(replace(state, status=failed), "status 0 in 6, 1 in 1")


@pytest.mark.parametrize("what", ["Section", "Beam", "Scene"])
def test_prints_where_vmap_shows_one_sample(what):
    seen = []

    def tip(EI):
        section = tb.Section.from_stiffness(EA=1e3, GA=400.0, GJ=0.8, EI=EI, mass=0.5)
        beam = tb.Beam.straight(1.0, 2, section)
        seen.append({"Section": section, "Beam": beam, "Scene": tb.Scene(beam)}[what])
        few_lines(seen[-1], what)
        return EI

    torch.func.vmap(tip)(torch.tensor([1.0, 2.0, 3.0]))
    assert len(seen) == 1


def test_tables_are_aligned():
    rows = [("what", "m", ""), ("force", "12.5", "N"), ("EI", "3", "")]
    assert aligned(rows, right=(1,)) == ["what      m", "force  12.5  N", "EI        3"]
