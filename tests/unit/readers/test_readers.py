"""Files of other programs: axes and signs by cantilevers whose answers are known, published blades,
and what is refused.
"""

import math
from dataclasses import fields
from pathlib import Path

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases import blade_files as files
from tests.cases.refusals import refusals
from torchbeam.extend import quaternions

BLADES = Path(__file__).parents[3] / "examples/blades"
NREL, IEA = BLADES / "nrel_5_mw_elastodyn.dat", BLADES / "iea_15_mw.yaml"
L, FLAP, EDGE, GJ = 10.0, 2e3, 8e3, 1e4
SMALL = 1e-6  # so small that displacements are linear


def straight(folder, K, M, twist=0.0, **options):
    """A uniform blade of 10 m along z."""
    points = [(0.0, 0, L * k / 8) for k in range(9)]
    stations = [(0.0, K, M), (1.0, K, M)]
    return files.beamdyn(folder, points, [twist] * 9, stations, **options)


def moved(beam, *effects):
    """What the tip moves by, and its rotation vector, by small loads, over SMALL."""
    state = tb.equilibrium(tb.Scene(beam, list(effects)))
    R = state.tip.rotation @ tb.rest(tb.Scene(beam)).tip.rotation.mT
    turn = torch.stack((R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])) / 2
    return (state.tip.position - beam.nodes[-1]) / SMALL, turn / SMALL


def tip_force(*force):
    return tb.TipLoad(force=tuple(SMALL * f for f in force))


@pytest.mark.parametrize("version", [1, 5])
def test_flap_is_along_the_files_x(tmp_path, version):
    """w = P L^3/(3 EI) + P L/kGA, with linked elements: along x of flap, along y of edge."""
    beam = tb.read(straight(tmp_path, *files.of_flap_and_edge(FLAP, EDGE), version=version))
    known = torch.tensor((L**3 / (3 * FLAP), L**3 / (3 * EDGE))) + L / 5e8
    for k in range(2):
        by = moved(beam.linked(), tip_force(*(float(i == k) for i in range(3))))[0]
        assert_close(by[k], known[k], rtol=1e-6, atol=0)
        assert by[1 - k].abs() < 1e-6


def test_twist_is_about_the_negative_z_axis(tmp_path):
    """By 30 degrees the soft direction is (cos, -sin, 0): a force along x moves the tip by
    P L^3/3 (cos^2/EI_f + sin^2/EI_e, -sin cos (1/EI_f - 1/EI_e)).
    """
    beam = tb.read(straight(tmp_path, *files.of_flap_and_edge(FLAP, EDGE), twist=30.0))
    c, s = math.cos(math.pi / 6), math.sin(math.pi / 6)
    by = moved(beam.linked(), tip_force(1.0, 0, 0))[0]
    soft, stiff = L**3 / (3 * FLAP), L**3 / (3 * EDGE)
    known = torch.tensor((c * c * soft + s * s * stiff, -s * c * (soft - stiff)))
    assert_close(by[:2], known, rtol=1e-5, atol=0)


def test_a_matrix_turned_by_the_twist_is_the_twisted_one(tmp_path):
    """A coupled section with its mass aside, in the file turned by 25 degrees and without twist:
    the same frequencies, and the same displacement, as with the twist.
    """
    K, M = files.of_flap_and_edge(FLAP, EDGE, x=0.1, y=-0.2, centre=(0.05, 0.1))
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    twisted = tb.read(straight(tmp_path / "a", K, M, twist=25.0))
    plain = tb.read(straight(tmp_path / "b", *(files.turned(x, 25.0) for x in (K, M))))
    frequency = [tb.modes(tb.Scene(beam), count=4).frequency for beam in (twisted, plain)]
    assert_close(*frequency, rtol=1e-7, atol=0)
    a, b = (moved(beam, tip_force(1.0, 2.0, 3.0))[0] for beam in (twisted, plain))
    assert_close(a, b, rtol=1e-5, atol=1e-6)


def test_stretch_off_the_axis_bends_towards_it(tmp_path):
    """EA at (x, y): a force along the axis at (0, 0) bends by the moment about the centre, the tip
    moves by F L^2/2 (x/EI_flap, y/EI_edge).
    """
    K, M = files.of_flap_and_edge(FLAP, EDGE, x=0.1, y=-0.2)
    by = moved(tb.read(straight(tmp_path, K, M)), tip_force(0, 0, 1.0))[0]
    assert_close(by[:2], L**2 / 2 * torch.tensor((0.1 / FLAP, -0.2 / EDGE)), rtol=1e-5, atol=0)


def test_mass_off_the_axis_twists_by_its_weight(tmp_path):
    """Mass at (a, b): a field g along y gives the torque m a g per length, along x -m b g; the tip
    turns about z by that times L^2/(2 GJ).
    """
    beam = tb.read(straight(tmp_path, *files.of_flap_and_edge(FLAP, EDGE, centre=(0.05, 0.1))))
    for g, torque in (((0, SMALL, 0), 0.05), ((SMALL, 0, 0), -0.1)):
        turn = moved(beam, tb.Gravity(g))[1]
        assert_close(turn[2], torch.tensor(3.0 * torque * L**2 / (2 * GJ)), rtol=1e-5, atol=0)


def test_damping_is_in_the_order_of_strains(tmp_path):
    """mu1, mu2 of shear along x and y, mu3 of stretch, mu4, mu5 of bending, mu6 of twist."""
    path = straight(tmp_path, *files.of_flap_and_edge(FLAP, EDGE))
    for file in (path, tmp_path / "blade.dat"):
        tau = torch.as_tensor(tb.read(file, part="damping").tau)
        assert tau.tolist() == [3.0, 1, 2, 6, 4, 5]


def test_prebend_and_sweep_are_the_nodes(tmp_path):
    """Points of the axis become nodes; equal elements lie on it; of order 2 as well."""
    K, M = files.of_flap_and_edge(FLAP, EDGE)
    points = [(-0.01 * z**2, 0.02 * z**2, z) for z in (0.0, 1, 2, 3, 4, 5, 6)]
    path = files.beamdyn(tmp_path, points, [5.0] * 7, [(0.0, K, M), (1.0, K, M)])
    beam = tb.read(path)
    assert_close(beam.nodes, torch.tensor(points))
    along = beam.nodes.diff(dim=-2)
    axes = quaternions.matrix(beam.elements)
    assert_close(axes[..., 0], along / along.norm(dim=-1, keepdim=True), rtol=0, atol=1e-9)
    for order in (1, 2):
        beam = tb.read(path, elements=4, order=order)
        assert_close(beam.nodes[[0, -1]], torch.tensor(points)[[0, -1]])
        assert_close(beam.length.sum(), torch.tensor(6.0697), rtol=2e-4, atol=0)


def test_composite_beam_of_wang(tmp_path):
    """Bending coupled with twist (Wang et al. 2017, Wind Energy 20, 1439-1462, section 5.2): 10 in,
    150 lb across. BeamDyn's tip moves by (-0.090272663, -0.064748849, 1.2297365) in along the beam
    and across (its values in Kynema's regression test static_composite_beam_bending). Eight
    elements of order 2 within 1e-5 of the deflection.
    """
    K = torch.diag(torch.tensor((1368.17e3, 88.56e3, 38.78e3, 16.96e3, 59.12e3, 141.47e3)))
    for i, j, value in ((3, 4, 17.61e3), (3, 5, -0.351e3), (4, 5, -0.37e3)):
        K[i, j] = K[j, i] = value
    back = [1, 2, 0, 4, 5, 3]  # BeamDyn's z is along the beam
    K = K[back][:, back].tolist()
    M = torch.diag(torch.tensor((1.0, 1, 1, 1, 1, 2))).tolist()
    beam = tb.read(straight(tmp_path, K, M), elements=8, order=2)
    state = tb.equilibrium(tb.Scene(beam, [tb.TipLoad(force=(0, 150.0, 0))]))
    along, across = -0.090272662756631, (-0.064748848625905, 1.2297364829237)
    known = torch.tensor((*across, along))
    assert_close(state.tip.position - beam.nodes[-1], known, rtol=0, atol=1.3e-5)


def test_windio_and_beamdyn_agree(tmp_path):
    """The IEA 15 MW blade, its numbers written as BeamDyn files: the same beam, to nine digits."""
    yaml = pytest.importorskip("yaml")
    blade = yaml.safe_load(IEA.read_text())["components"]["blade"]
    axis, twist = blade["reference_axis"], blade["outer_shape"]["twist"]["values"]
    elastic = blade["structure"]["elastic_properties"]
    K, I = elastic["stiffness_matrix"], elastic["inertia_matrix"]
    stations = []
    for k, eta in enumerate(K["grid"]):
        name = lambda i, j: f"K{min(i, j) + 1}{max(i, j) + 1}"  # noqa: E731
        stiffness = [[K.get(name(i, j), [0] * 99)[k] for j in range(6)] for i in range(6)]
        m, x, y = (I[name][k] for name in ("mass", "cm_x", "cm_y"))
        mass = [[0.0] * 6 for _ in range(6)]
        for i, value in enumerate((m, m, m, *(I[n][k] for n in ("i_edge", "i_flap", "i_plr")))):
            mass[i][i] = value
        entries = ((0, 5, -m * y), (1, 5, m * x), (2, 3, m * y), (2, 4, -m * x))
        for i, j, value in (*entries, (3, 4, -I["i_cp"][k])):
            mass[i][j] = mass[j][i] = value
        stations.append((eta, stiffness, mass))
    z = axis["z"]["values"]
    points = [(x, 0.0, z) for x, z in zip(axis["x"]["values"], z, strict=True)]
    there, here = tb.read(files.beamdyn(tmp_path, points, twist, stations)), tb.read(IEA)
    for field in fields(here):
        a, b = getattr(there, field.name), getattr(here, field.name)
        if isinstance(a, torch.Tensor):
            assert_close(a, b, rtol=1e-6, atol=1e-7 * b.abs().max().item(), msg=field.name)
        else:
            assert a == b


def test_nrel_5_mw():
    """Against pyBmodes 1.19.1, which agrees with NREL's BModes (its own test, 0.01 %), 120 of its
    elements, from the same numbers: 0.67758, 1.08638, 1.95388, 4.00836, 4.55459 and 8.07387 Hz. 24
    linked elements are off by up to 0.034 %, as 96 are. Jonkman et al. 2009 (NREL/TP-500-38060):
    mass 17,740 kg, moments 363,231 kg m and 11,776,047 kg m^2, which FAST sums over 17 elements;
    those of the table are 0.5 to 0.8 % less.
    """
    blade = tb.read(NREL, length=61.5, elements=24).linked()
    known = torch.tensor((0.67758, 1.08638, 1.95388, 4.00836, 4.55459, 8.07387))
    found = tb.modes(tb.Scene(blade), count=6).frequency / (2 * math.pi)
    assert_close(found, known, rtol=5e-4, atol=0)
    m, z = blade.mass[:, 0, 0] * blade.length, (blade.nodes[1:, 2] + blade.nodes[:-1, 2]) / 2
    sums = torch.stack([(m * z**k).sum() for k in range(3)])
    assert_close(sums, torch.tensor((17740.0, 363231.0, 11776047.0)), rtol=8e-3, atol=0)


def test_elastodyn_primary_file(tmp_path):
    """Length from the hub's radius to the tip; the tower from its base; factors."""
    path = files.elastodyn(tmp_path, flap=FLAP, edge=EDGE, length=L)
    blade, tower = (tb.read(path, elements=4, part=part) for part in ("blade", "tower"))
    assert_close(blade.nodes[-1], torch.tensor((0.0, 0, L)))
    assert_close(tower.nodes[-1], torch.tensor((0.0, 0, 80.0)))
    assert tower.mass[0, 0, 0] == 2 * blade.mass[0, 0, 0] == 6.0
    for beam, length in ((blade, L), (tower, 80.0)):
        for k, EI in ((0, FLAP), (1, EDGE)):
            by = moved(beam.linked(), tip_force(*(float(i == k) for i in range(3))))[0]
            assert_close(by[k], torch.tensor(length**3 / (3 * EI)), rtol=2e-4, atol=0)
    alone = tb.read(tmp_path / "blade.dat", length=L, elements=4)
    assert_close(alone.nodes, blade.nodes)
    assert_close(tb.read(tmp_path / "tower.dat", length=80.0, elements=4).mass, tower.mass)
    with pytest.raises(ValueError, match=r"part = .blade. of tower\.dat was given; part = .tower."):
        tb.read(tmp_path / "tower.dat", part="blade", length=80.0)
    with pytest.raises(ValueError, match="does not say how long it is"):
        tb.read(tmp_path / "tower.dat")


def test_a_tip_within_the_hub_is_refused(tmp_path):
    """Radii that changed places would make a blade that points inwards."""
    path = files.elastodyn(tmp_path, flap=FLAP, edge=EDGE, length=L)
    with pytest.raises(ValueError, match=r"TipRad = 1 in .* line 3, .*more than HubRad = 1.5"):
        tb.read(damaged(path, f"{L + 1.5} TipRad", "1.0 TipRad"))


def test_a_byte_order_mark_is_no_part_of_the_first_value(tmp_path):
    path = files.elastodyn(tmp_path, flap=FLAP, edge=EDGE, length=L)
    lines = path.read_text().splitlines()[2:]  # TipRad is the first
    path.write_text("\n".join(lines), encoding="utf-8-sig")
    assert_close(tb.read(path).nodes[-1], torch.tensor((0.0, 0, L)))


@pytest.mark.parametrize("write", [files.vabs, files.swiftcomp])
def test_a_section_of_vabs_is_about_its_origin(tmp_path, write):
    """A unit square of density 1 whose corner is the origin: its mass as SwiftComp prints it (sgio,
    tests/fixtures/swiftcomp/sg2-BM2-E), that of a square about its middle, shifted.
    """
    square = tb.Section.rectangle(1.0, 1.0, E=1.0, nu=0.3, rho=1.0).shifted(-0.5, -0.5)
    K = torch.linalg.inv(square.compliance)
    assert_close(K[0, 4:], torch.tensor((0.5, -0.5)))
    printed = torch.diag(torch.tensor((1.0, 1, 1, 2 / 3, 1 / 3, 1 / 3)))
    for i, j, value in ((0, 4, 0.5), (0, 5, -0.5), (1, 3, -0.5), (2, 3, 0.5), (4, 5, -0.25)):
        printed[i, j] = printed[j, i] = value
    section = tb.read(write(tmp_path, K.tolist(), printed.tolist()))
    assert_close(section.mass, square.mass, rtol=1e-8, atol=1e-9)
    assert_close(section.compliance, square.compliance, rtol=1e-7, atol=1e-8)


def test_a_classical_section_does_not_shear(tmp_path):
    K = [[1e5, 0, 0, 0], [0, 2.0, 0.1, 0], [0, 0.1, 3.0, 0], [0, 0, 0, 4.0]]
    M = torch.diag(torch.tensor((1.0, 1, 1, 0.02, 0.01, 0.01))).tolist()
    section = tb.read(files.vabs(tmp_path, K, M, "Classical Stiffness Matrix (1-extension)"))
    assert section.rigid == (False, True, True, False, False, False)
    assert_close(section.compliance[5, 5], torch.tensor(0.25))
    assert section.compliance[3, 4] < 0


def test_a_singular_classical_stiffness_is_refused(tmp_path):
    K, M = torch.ones(4, 4).tolist(), torch.eye(6).tolist()
    path = files.vabs(tmp_path, K, M, "Classical Stiffness Matrix (1-extension)")
    with pytest.raises(ValueError, match=f"{path.name}: a stiffness that is singular"):
        tb.read(path)


def damaged(path, old, new, count=1):
    path.write_text(path.read_text().replace(old, new, count))
    return path


@refusals(
    (lambda p: damaged(p, "kp_total", "kp_count"), {}, "the file beamdyn.dat was given; one of"),
    (lambda p: damaged(p, "9  kp_total", "8  kp_total"), {}, "kp_total = 8 with members of 9"),
    (lambda p: damaged(p, "9  kp_total", "x  kp_total"), {}, "line 10,.*whole number from 2 on"),
    (lambda p: damaged(p, "blade.dat", "none.dat"), {}, "none.dat', where there is no file"),
    (lambda p: p, dict(length=3.0), "length = 3 with beamdyn.dat, which says it"),
    (lambda p: p, dict(part="tower"), "part = 'tower' of beamdyn.dat"),
    (lambda p: p, dict(length=-3.0), "length = -3 was given; a positive one"),
    (lambda p: p, dict(part="wing"), "part = 'wing' was given"),
    (lambda p: p, dict(format="vabs"), "one of format 'vabs' is wanted"),
    (lambda p: p, dict(format="bladed"), "format = 'bladed' was given"),
    (lambda p: p, dict(elements=0), "elements = 0 was given"),
    (lambda p: p, dict(order=3), "order = 3"),
    (lambda p: p, dict(part="damping", elements=4), "elements or order for 'damping'"),
    (lambda p: p.with_name("blade.dat"), {}, "without its key points"),
    (lambda p: p.parent, {}, "where there is no file"),
    (
        lambda p: damaged(p, "kp_total", "kp_count").rename(p.with_name("record.CSV")),
        {},
        "the file record.CSV, whose columns numpy.loadtxt reads for a tb.Measurement, was given",
    ),
)
def test_what_is_refused(damage, options, tmp_path):
    path = damage(straight(tmp_path, *files.of_flap_and_edge(FLAP, EDGE)))
    yield
    tb.read(path, **options)


def cut(text, lines):
    return "\n".join(text.splitlines()[:lines]) + "\n"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda t: cut(t, 20), "an end of file in blade.dat, line 20, was given; 6 numbers of a"),
        (lambda t: t.replace("2  station_total", "3  station_total"), "an end of file"),
        (lambda t: t.replace("8.0", "abc", 1), "blade.dat, line 18,.*6 numbers of a stiffness are"),
        (lambda t: t.replace("1.000000000", "0.9"), "stations from 0 to 0.9"),
        (
            lambda t: t.replace(" 2.000000000000000E+03", "-2.000000000000000E+03", 1),
            "not positive in blade.dat",
        ),
        (lambda t: t.replace("1  damp_type", "1  damping"), None),
    ],
)
def test_a_damaged_blade_file_is_refused(tmp_path, change, sentence):
    path = straight(tmp_path, *files.of_flap_and_edge(FLAP, EDGE))
    blade = tmp_path / "blade.dat"
    blade.write_text(change(blade.read_text()))
    if sentence is None:  # which a beam does not need
        assert tb.read(path).element_count == 8
        return
    with pytest.raises(ValueError, match=sentence):
        tb.read(path)


def test_an_asymmetric_matrix_is_refused(tmp_path):
    K, M = files.of_flap_and_edge(FLAP, EDGE, x=0.1)
    K[2][4] *= 1.001
    path = straight(tmp_path, K, M)
    with pytest.raises(ValueError, match=r"not symmetric .* in blade.dat, line 15,"):
        tb.read(path)
    with pytest.raises(ValueError, match=r"section.sg.K, line \d+, .*symmetric one is wanted"):
        tb.read(files.vabs(tmp_path, K, M))


@refusals(
    ("reference_axis", "axis", "without 'reference_axis'"),
    ("K66: [", "K66: [1.0, ", "27 values for 26 places"),
    ("K66: [8", "K66: [-8", "stiffness_matrix at 0 that has a diagonal entry"),
    ("twist:", "twist: [", "a line that is no YAML"),
    ("values: [0,", "values: [zero,", r"values = \['zero', .* a list is wanted"),
)
def test_a_damaged_windio_file_is_refused(old, new, tmp_path):
    pytest.importorskip("yaml")
    path = tmp_path / "turbine.yaml"
    path.write_text(IEA.read_text().replace(old, new, 1))
    yield
    tb.read(path)


def test_a_windio_blade_that_is_a_number_is_refused(tmp_path):
    pytest.importorskip("yaml")
    path = tmp_path / "turbine.yaml"
    path.write_text("components: {blade: 3}")
    with pytest.raises(ValueError, match="components: blade without 'structure'"):
        tb.read(path)


def test_windio_1_lists_triangles(tmp_path):
    """Version 1: 21 numbers of the upper triangle a station, twist in rad; as BeamDyn reads it."""
    yaml = pytest.importorskip("yaml")
    K, M = files.of_flap_and_edge(FLAP, EDGE, x=0.1, y=-0.2, centre=(0.05, 0.1))
    upper = lambda A: [A[i][j] for i in range(6) for j in range(i, 6)]  # noqa: E731
    grid = [0.0, 1.0]

    def table(values):
        return dict(grid=grid, values=values)

    elastic = dict(
        reference_axis=dict(x=table([0.0, 0.0]), y=table([0.0, 0.0]), z=table([0.0, L])),
        twist=table([math.radians(20)] * 2),
        stiff_matrix=table([upper(K)] * 2),
        inertia_matrix=table([upper(M)] * 2),
    )
    blade = dict(elastic_properties_mb=dict(six_x_six=elastic))
    path = tmp_path / "turbine.yaml"
    path.write_text(yaml.safe_dump(dict(components=dict(blade=blade))))
    here = tb.read(path, elements=4)
    there = tb.read(straight(tmp_path, K, M, twist=20.0), elements=4)
    assert_close(here.compliance, there.compliance, rtol=1e-8, atol=1e-12)
    assert_close(here.mass, there.mass, rtol=1e-8, atol=1e-12)
    assert_close(here.elements, there.elements, rtol=0, atol=1e-9)
