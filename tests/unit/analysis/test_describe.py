"""What a scene says of itself, and the command line that prints it."""

import math

import pytest
import torch

import torchbeam as tb
from studies.__main__ import main as run_study
from torchbeam.cli import main

SECTION = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=0.8, EI=(1.0, 1.2), mass=0.2, inertia=1e-3)
BEAM = tb.Beam.straight(1.0, 4, SECTION)
LIFTED = [tb.TipLoad(force=(0, 0, 2.0))]


def said(scene):
    return str(tb.describe(scene))


def test_counts_are_those_of_the_forms():
    """4 elements: 24 moves in space, 12 in a plane; states of the explicit forms are what they
    integrate.
    """
    t = torch.tensor([0.0, 0.001])
    scene = tb.Scene(BEAM, LIFTED)
    found = tb.describe(scene)
    assert found.unknowns == 24 and tb.describe(tb.Scene(BEAM, LIFTED, plane="xz")).unknowns == 12
    assert tb.describe(tb.Scene(BEAM, supports=())).unknowns == 30
    assert found.states["minimal"] == 12 * 4 and found.states["block_rate"] == 24 * 4 + 12
    # position, quaternion, velocity and spin of a node; the work
    assert found.states["nodal, explicit"] == 4 * 13 + 1
    assert tb.linearize(scene).A.shape[-1] == found.states["nodal, 'midpoint'"]
    assert tb.simulate(scene, t, form="minimal").status == 0 and not found.refusals


def test_refusals_are_those_of_the_forms():
    """What describe says of a form is the sentence that the form says."""
    scene = tb.Scene(
        BEAM,
        [*LIFTED, tb.Damping(0.1), tb.PointMass(0.1, offset=(0, 0, 0.1))],
        supports=(tb.Support(0), tb.Support(-1, position="y", rotation="")),
    )
    found = tb.describe(scene)
    calls = {
        "nodal, 'generalized_alpha'": dict(method="generalized_alpha"),
        "minimal": dict(form="minimal"),
        "block_rate": dict(form="block_rate"),
    }
    assert found.refusals.keys() == calls.keys() and all(
        found.states[name] is None for name in calls
    )
    for name, how in calls.items():
        with pytest.raises(ValueError) as caught:
            tb.simulate(scene, [0.0, 0.1], **how)
        assert str(caught.value) == found.refusals[name] and found.refusals[name] in str(found)


def test_planes_are_found_but_not_taken():
    """In space, it says in which planes all numbers lie; an Input may leave them; "auto" takes the
    plane.
    """
    assert tb.describe(tb.Scene(BEAM, LIFTED)).planes == ("xz",) and tb.describe(
        tb.Scene(BEAM)
    ).planes == ("xy", "xz")
    assert "plane='xz' gives the same answer with half the unknowns" in said(tb.Scene(BEAM, LIFTED))
    assert tb.describe(tb.Scene(BEAM, [tb.TipLoad(force=(0, 1.0, 1.0))])).planes == ()
    driven = said(tb.Scene(BEAM, [*LIFTED, tb.TipLoad(force=tb.Input("u", 3))]))
    assert (
        "plane='xz' halves the unknowns, if what its functions and inputs do lies in it" in driven
    )
    auto = tb.describe(tb.Scene(BEAM, LIFTED, plane="auto"))
    assert (
        auto.plane == "xz"
        and auto.planes == ()
        and "the plane xz, found in its numbers" in str(auto)
    )


def test_it_names_what_is_there():
    stiff = tb.Section.from_stiffness(
        EA=math.inf, GA=math.inf, GJ=1.0, EI=1.0, mass=torch.tensor([1.0, 2.0])
    )
    effects = [
        tb.PointLoad(moment=tb.Input("m", 3), node=1, follower=True),
        tb.MassDamping(0.5),
        tb.LineLoad(force=torch.zeros(2, 3)),
    ]
    text = said(
        tb.Scene(
            tb.Beam.straight(2.0, 3, stiff),
            effects,
            frame=tb.Frame(angular_velocity=lambda t: t.expand(3)),
            supports=(
                tb.Support(0, displacement=lambda t: t.expand(3)),
                tb.Support(-1, position="yz", rotation="xz"),
            ),
        )
    )
    for wanted in (
        "3 elements, 2 m long",
        "inextensible and unshearable; no rotary inertia",
        "axes (2,); float64 on cpu",
        "PointLoad at node 1: moment = input 'm', follower",
        "MassDamping along the beam: alpha = 0.5",
        "LineLoad along the beam: force = of shape (2, 3)",
        "m (3)",
        "node 0: clamped, moved by its displacement",
        "node 3: position yz held, hinged about y",
        "angular velocity a function",
    ):
        assert wanted in text, wanted


def test_frequencies_are_in_double_precision():
    """A float32 scene with EA = 4e6 EI: first frequency 3.516 sqrt(EI/m)/L^2, to 4 elements' 3 %;
    loads and frames apart.
    """
    of = tb.Section.from_stiffness(EA=4e6, GA=1e6, GJ=1.0, EI=1.0, mass=1.0)
    turning = tb.Frame(angular_velocity=(0, 0, 1.0))
    scene = tb.Scene(
        tb.Beam.straight(1.0, 4, of), [tb.TipLoad(force=(0, 0, 1.0))], frame=turning
    ).to(torch.float32)
    first = tb.describe(scene).lines["frequencies"][0].split(",")[0]
    assert abs(float(first) / 3.516 - 1) < 0.03


def test_frequencies_are_wet_and_sprung():
    """Added mass of three times the beam's, also in a stream, halves them; a spring at the tip
    raises them.
    """
    of = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=1.0, EI=1.0, mass=1.0)
    beam = tb.Beam.straight(1.0, 16, of)

    def first(*effects):
        return float(tb.describe(tb.Scene(beam, effects)).lines["frequencies"][0].split(",")[0])

    added = tb.Drag(3 / (math.pi / 4), 1.0, added_mass=1.0, flow=(0.0, 5.0, 0.0))
    assert abs(first(added) / first(tb.TipLoad(force=(0, 0, 1.0))) - 0.5) < 2e-3
    assert first(tb.Spring(-1, 50.0, to=(1, 0, 0))) > 7


def test_command(tmp_path, capsys):
    """`info FILE` prints its scene, or all Scenes; a missing file, or one without a Scene, is an
    error of the command line.
    """
    text = (
        "import torchbeam as tb\nof = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=1., EI=1., "
        "mass=1.)\n"
    )
    both = tmp_path / "both.py"
    both.write_text(
        text
        + "".join(
            f"{name} = tb.Scene(tb.Beam.straight(1., {n}, of))\n"
            for name, n in (("a", 2), ("b", 3))
        )
    )
    assert main(["info", str(both)]) == 0
    out = capsys.readouterr().out
    assert "a:\nbeam " in out and "b:\nbeam " in out and "2 elements" in out and "3 elements" in out
    empty = tmp_path / "empty.py"
    empty.write_text("x = 1\n")
    wrong = {
        empty: "without a torchbeam.Scene was given",
        tmp_path / "none.py": "none.py was given; a Python file",
    }
    for path, sentence in wrong.items():
        with pytest.raises(SystemExit) as caught:
            main(["info", str(path)])
        assert caught.value.code == 2 and sentence in capsys.readouterr().err


def test_version(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == 0 and capsys.readouterr().out.startswith("torchbeam ")


@pytest.mark.parametrize("command", ["hardcases", "verify"])
def test_filter_that_leaves_nothing(command, capsys):
    with pytest.raises(SystemExit) as caught:
        run_study([command, "--filter", "nosuch"])
    assert (
        caught.value.code == 2
        and "--filter 'nosuch' was given; no case has that" in capsys.readouterr().err
    )


@pytest.mark.parametrize("height, deep", [(1.9, ""), (50.0, "50 m deep, more than the length")])
def test_a_section_deeper_than_its_beam_is_long_is_named(height, deep):
    """Of a beam of 2 m: 50 mm in place of 0.05 m; of a part of a structure too."""
    section = tb.Section.rectangle(0.03, height, E=210e9, nu=0.3, rho=7800.0)
    beam = tb.Beam.straight(2.0, 4, section)
    for scene in (tb.Scene(beam), tb.Scene({"arm": beam}, supports=tb.Support(("arm", 0)))):
        text = said(scene)
        assert (deep in text) and ("deep" in text) == bool(deep)


def test_whose_a_batch_is_where_values_along_the_beam_may_have_been_meant():
    """As many samples as elements or nodes, by one of the scene's things alone."""
    of = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=0.8, EI=torch.ones(5), mass=0.2)
    forces = torch.ones(4, 3)
    for beam, effects, owner in (
        (BEAM, [tb.LineLoad(force=forces)], "LineLoad"),
        (tb.Beam.straight(1.0, 4, of), [], "the beam"),
        (BEAM, [tb.LineLoad(force=forces), tb.TipLoad(force=forces)], None),
        (BEAM, [tb.LineLoad(force=torch.ones(3, 3))], None),
    ):
        lines = tb.describe(tb.Scene(beam, effects)).lines["batch"]
        assert len(lines) == (1 if owner is None else 2)
        assert owner is None or lines[1].startswith(f"by {owner} alone")


def test_what_remembers():
    """What arms have crept by is in a state of every method: in the plane 3 strains of 2 elements
    and 2 arms beside 2 x 6 moves. A joint's law is named, and methods that refuse it are told of.
    """
    section = tb.Section.from_stiffness(EA=1e3, GA=1e3, GJ=1.0, EI=1.0, mass=0.1)
    beam, arms = tb.Beam.straight(1.0, 2, section), tb.Viscoelastic((0.2, 0.1), (0.1, 1.0))
    states = tb.describe(tb.Scene(beam, [arms], plane="xz")).states
    assert states["nodal, 'midpoint'"] == states["nodal, 'midpoint4'"] == 12 + 12
    for law, name in (
        (dict(hysteresis=tb.ElastoPlastic(1.0, 0.1)), "ElastoPlastic"),
        (dict(torque=lambda rate: -rate), "Drive"),
    ):
        hinge = tb.Hinge(None, ("arm", 0), **law)
        description = tb.describe(tb.Scene({"arm": beam}, joints=[hinge], plane="xz"))
        assert description.lines["joints"][0].endswith(f"holds 5 components, {name}")
        refused = "midpoint4" in " ".join(description.refusals.values())
        assert refused == (name == "ElastoPlastic")


def test_damping_ratios_are_those_of_the_modes():
    """tau w/2 + alpha/(2 w), to two digits; nothing where damping differs along the beam,
    and where other things damp it.
    """
    section = tb.Section.rectangle(0.03, 0.002, E=69e9, nu=0.33, rho=2700.0)
    damping = [tb.Damping(2e-3), tb.MassDamping(1.0)]
    scene = tb.Scene(tb.Beam.straight(1.0, 8, section), damping)
    (line,) = tb.describe(scene).lines["frequencies"]
    ratios = line.partition("damping ratios ")[2].partition(" (")[0].split(", ")
    found = tb.modes(scene, count=3).damping_ratio
    assert [float(x) for x in ratios] == pytest.approx(found.tolist(), rel=0.02)  # two digits
    relaxing = [tb.MassDamping(1.0), tb.Viscoelastic([0.5], [0.1])]
    for other in ([], [tb.Damping([0.1] * 6)], [tb.Damping(torch.tensor([0.1, 0.2]))], relaxing):
        (line,) = tb.describe(tb.Scene(scene.beam, other)).lines["frequencies"]
        assert "ratios" not in line


def test_a_contact_without_a_radius_says_that_axes_touch():
    """Of two beams, and of one with an obstacle; not where a radius or a body's surface is."""
    floor, ball = tb.Plane((0, 0, -0.1), (0, 0, 1)), tb.Sphere((0, 0, 0), 0.01)
    rod = tb.Section.circle(0.005, E=1e8, nu=0.35, rho=1200.0)
    parts = {
        "a": tb.Beam.straight(0.2, 1, rod),
        "b": tb.Beam.straight(0.2, 1, rod, root=(0, 0, 0.1)),
        "ball": tb.Body(0.1, 1e-4, position=(0, 0, 0.3), surface=ball),
    }
    contacts = [
        tb.Contact("a", floor),
        tb.Contact("a", "b"),
        tb.Contact("a", floor, radius=0.005),
        tb.Contact("ball", "b"),
    ]
    scene = tb.Scene(parts, contacts, supports=[tb.Support(("a", 0)), tb.Support(("b", 0))])
    lines = tb.describe(scene).lines["effects"]
    assert [line.endswith("no radius: axes touch") for line in lines] == [True, True, False, False]
    sinks = [line.endswith("that pushes sinks in") for line in lines]
    assert sinks == [False, False, True, False]
    cap = tb.Contact(floor, radius=0.005, node=("a", -1))
    capped = tb.Scene(parts, [*contacts, cap], supports=scene.supports)
    assert not any("sinks in" in line for line in tb.describe(capped).lines["effects"])


def test_eyelets_are_counted():
    """Those of a tendon along a beam by their ends, of any number."""
    beam = tb.Beam.straight(1.0, 24, SECTION)
    pull = tb.Tendon.along(beam, (0, 0, 0.02), tension=2.0)
    assert "eyelets = 25 from node 0 to node 24, tension = 2" in said(tb.Scene(beam, [pull]))
    hung = tb.Tendon([(None, (0, 0, 1.0)), (-1, (0, 0, 0))], tension=2.0)
    assert "eyelets = 2 from the ground to node 4" in said(tb.Scene(BEAM, [hung]))
