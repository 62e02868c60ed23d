"""Winds against their formulas, spectra against von Karman's and Kaimal's, tables against SciPy."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.interpolate import RegularGridInterpolator
from scipy.special import gamma, kv
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals

DOUBLE = torch.float64
NOW = torch.tensor(0.4, dtype=DOUBLE)


def places(*rows):
    return torch.tensor(rows, dtype=DOUBLE)


def test_profiles_are_the_power_law_and_the_logarithmic_one():
    """At 0, 60 m above and below the ground of an origin at 90 m."""
    x = places((0, 0, 0), (5, 2, 60), (0, 0, -90.5))
    power = tb.Wind((10.0, 0, 0), exponent=0.2, height=90.0).velocity(x, NOW)[:, 0]
    assert_close(power, torch.tensor([10, 10 * (150 / 90) ** 0.2, 0], dtype=DOUBLE))
    log = tb.Wind((10.0, 0, 0), roughness=0.03, height=90.0).velocity(x, NOW)[:, 0]
    ratio = math.log(150 / 0.03) / math.log(90 / 0.03)
    assert_close(log, torch.tensor([10, 10 * ratio, 0], dtype=DOUBLE))


def test_gradients_of_profiles_are_finite_below_the_ground():
    x = places((0, 0, 10), (0, 0, -200)).requires_grad_()
    for given in (dict(exponent=0.2), dict(roughness=0.03)):
        wind = tb.Wind((10.0, 0, 0), height=90.0, **given)
        (slope,) = torch.autograd.grad(wind.velocity(x, NOW).sum(), x)
        assert slope.isfinite().all() and slope[0, 2] > 0 and slope[1, 2] == 0


def test_a_gust_is_one_minus_cosine_where_it_has_come_to():
    """CS 25.341(a): U_ds/2 (1 - cos(pi s/H)) from s = 0 to 2 H, 0 elsewhere, in a batch of H."""
    H = torch.tensor([10.0, 20.0], dtype=DOUBLE)
    gust = tb.Gust((0, 0, 4.0), H, speed=50.0, direction=(0, -2.0, 0), start=0.1)
    x = places((0, 0, 0), (3, 12, 1), (0, -10, 0), (0, 100, 0))
    s = 50.0 * (0.4 - 0.1) - x @ places((0, -1, 0))[0]
    for k, h in enumerate(H.tolist()):
        want = torch.where((s > 0) & (s < 2 * h), 2 * (1 - torch.cos(math.pi * s / h)), 0.0)
        assert_close(gust.velocity(x, NOW)[k, :, 2], want)
    everywhere = tb.Gust((0, 0, 4.0), 10.0, speed=50.0)
    assert_close(everywhere.velocity(x, torch.tensor(0.2, dtype=DOUBLE))[:, 2], x[:, 0] * 0 + 4.0)


def test_the_design_gust_of_cs_25():
    """U_ref at 350 ft; (30/350)^(1/6) of it at 30 ft: CS 25.341(a)(4)."""
    H = torch.tensor([9.144, 106.68], dtype=DOUBLE)
    peak = tb.Gust.certification(17.07, H, speed=200.0, alleviation=0.8).peak[:, 2]
    assert_close(peak, 0.8 * 17.07 * torch.tensor([(30 / 350) ** (1 / 6), 1.0], dtype=DOUBLE))


def test_winds_are_added():
    gust = tb.Gust((0, 0, 4.0), 10.0, speed=50.0)
    both = tb.Wind((10.0, 0, 0)) + gust + tb.Wind(lambda t: torch.stack((0 * t, t, 0 * t)))
    x = places((0, 0, 0), (1, 2, 3))
    want = gust.velocity(x, NOW) + places((10.0, 0.4, 0))
    assert_close(both.velocity(x, NOW), want)
    assert_close(sum([gust, gust]).velocity(x, NOW), 2 * gust.velocity(x, NOW))
    with pytest.raises(TypeError):
        1.0 + gust


def karman(k, sigma, L, along):
    q = (1.339 * L * k) ** 2
    if along:
        return 2 * sigma**2 * L / math.pi * (1 + q) ** (-5 / 6)
    return sigma**2 * L / math.pi * (1 + 8 / 3 * q) * (1 + q) ** (-11 / 6)


def kaimal(k, sigma, L, along):
    n = k / (2 * math.pi)
    return 4 * sigma**2 * L / (1 + 6 * n * L) ** (5 / 3) / (2 * math.pi)


@pytest.mark.parametrize("name,spectrum", [("von-karman", karman), ("kaimal", kaimal)])
def test_the_spectrum_in_time_is_the_formulas(name, spectrum):
    """Power of u and w by octaves of the wave number, of a record of 41 km by its Fourier transform
    (what a place sees in 4,096 s): each octave's share of the variance as the formula's integral
    has it. The longest waves, 32 in the record, leak by the window: 1 %.
    """
    U, sigma, L = 10.0, (1.5, 1.0, 0.7), (100.0, 60.0, 30.0)
    ends = 2.0 ** np.arange(-1, 7)  # waves by length, so that edges are those of bands
    wind = tb.Turbulence((U, 0, 0), sigma, L, spectrum=name, seed=5, harmonics=28, band=(0.5, 64.0))
    t = torch.arange(0, 4096, 0.25, dtype=DOUBLE)
    v = wind.velocity(-U * t[:, None] * places((1, 0, 0)), 0 * NOW)
    v = (v - v.new_tensor([U, 0, 0])).numpy() * np.hanning(len(t))[:, None]
    power = 2 * np.abs(np.fft.rfft(v, axis=0)) ** 2 / (len(t) * (np.hanning(len(t)) ** 2).sum())
    k = 2 * math.pi * np.fft.rfftfreq(len(t), 0.25) / U * L[0]
    for c, along in ((0, True), (2, False)):
        got = [power[(k >= a) & (k < b), c].sum() for a, b in pairwise(ends)]
        want = [
            quad(spectrum, a / L[0], b / L[0], args=(sigma[c], L[c], along))[0]
            for a, b in pairwise(ends)
        ]
        np.testing.assert_allclose(got, want, rtol=0.01)


def test_spectra_hold_the_variance():
    """Over all wave numbers the integral is sigma^2; the harmonics have what the formula has within
    the band that is asked for by default, to 1e-5, which is 95 % of that.
    """
    for along in (True, False):
        assert quad(karman, 0, np.inf, args=(1.5, 100.0, along), limit=200)[0] == pytest.approx(
            1.5**2, rel=1e-3
        )
    wind = tb.Turbulence((10.0, 0, 0), 1.5, 100.0, seed=1)
    variance = (wind._cosine.square() + wind._sine.square()).sum(-2) / 2
    for c, along in ((0, True), (1, False), (2, False)):
        want = sum(
            quad(karman, a / 100, b / 100, args=(1.5, 100.0, along))[0]
            for a, b in ((0.03, 1), (1, 30), (30, 300))
        )
        assert variance[c].item() == pytest.approx(want, rel=1e-5)
        assert want > 0.95 * 1.5**2


def test_isotropic_turbulence_is_von_karmans_field():
    """No divergence; the energy of von Karman's spectrum within the band, to 1e-5. Over 400 seeds
    the correlation of the component along a distance r is his 2^(2/3)/Gamma(1/3) x^(1/3) K_1/3(x),
    x = r/(1.339 L), within three standard errors and the 2.7 % that lie outside of the band.
    """
    sigma, L, seeds = 1.5, 100.0, 400
    wind = tb.Turbulence((0.0, 20.0, 0), sigma, L, isotropic=True, seed=range(seeds), harmonics=32)
    waves, a, b = wind._waves, wind._cosine, wind._sine
    assert (waves * a).sum(-1).abs().max() < 1e-12 * waves.abs().max()
    assert ((waves * b).sum(-1)).abs().max() < 1e-12 * waves.abs().max()
    square = (a.square() + b.square()) / 2

    def energy(q):
        return 55 / (9 * math.pi) * (1.339 * q) ** 4 / (1 + (1.339 * q) ** 2) ** (17 / 6)

    want = sum(quad(energy, a, b)[0] for a, b in ((0.03, 1), (1, 30), (30, 300)))
    assert want > 0.973 * 1.5
    assert_close(
        square.sum((-2, -1)) / 2, square.new_full((seeds,), want * sigma**2), rtol=1e-5, atol=0
    )
    for r in (20.0, 100.0, 250.0):
        x = r / (1.339 * L)
        want = 2 ** (2 / 3) / gamma(1 / 3) * x ** (1 / 3) * kv(1 / 3, x)
        along = (square[..., 2] * torch.cos(waves[..., 2] * r)).sum(-1) / sigma**2
        error = along.std() / seeds**0.5
        assert abs(along.mean() - want) < 3 * error + 0.027


def test_turbulence_is_carried_along_by_the_mean_wind():
    """Taylor: what is at x now is at x + mean dt then; several seeds are a batch of each alone."""
    mean, x = places((3.0, -8.0, 1.0))[0], places((1, 2, 3), (-4, 5, 6))
    for isotropic in (False, True):
        both = tb.Turbulence(mean, 1.0, 20.0, isotropic=isotropic, seed=(1, 2))
        alone = tb.Turbulence(mean, 1.0, 20.0, isotropic=isotropic, seed=2)
        now = both.velocity(x, NOW)
        assert_close(both.velocity(x + 0.7 * mean, NOW + 0.7), now)
        assert_close(alone.velocity(x, NOW), now[1])


def test_a_table_is_linear_in_time_and_place():
    """Against SciPy's grid interpolation, constant beyond the table; a table of more places than
    native code takes is the same.
    """
    generator = torch.Generator().manual_seed(0)
    values = torch.randn(5, 4, 3, 2, 3, dtype=DOUBLE, generator=generator)
    grid = dict(x=[0.0, 1, 2, 3], y=[0.0, 2, 4], z=[0.0, 0.7])
    table = tb.WindTable([0.0, 1, 2, 3, 4], values, **grid)
    x = 5 * torch.rand(20, 3, dtype=DOUBLE, generator=generator) - 1
    want = RegularGridInterpolator((np.arange(5.0), *map(np.array, grid.values())), values.numpy())
    inside = np.clip(x.numpy(), 0, [3, 4, 0.7])
    want = torch.from_numpy(want(np.c_[np.full(20, 1.3), inside]))
    assert_close(table.velocity(x, torch.tensor(1.3, dtype=DOUBLE)), want)
    fine = torch.nn.functional.interpolate(
        values.permute(0, 4, 1, 2, 3), (46, 3, 2), mode="trilinear", align_corners=True
    ).permute(0, 2, 3, 4, 1)
    large = tb.WindTable(
        [0.0, 1, 2, 3, 4], fine, x=torch.linspace(0, 3, 46, dtype=DOUBLE), y=grid["y"], z=grid["z"]
    )
    assert_close(large.velocity(x, torch.tensor(1.3, dtype=DOUBLE)), want)
    column = tb.WindTable([0.0, 1], values[:2, :1, :1], z=grid["z"])
    assert_close(column.velocity(x, NOW), column.velocity(x * x.new_tensor([0, 0, 1]), NOW))


STRIP = tb.Section.from_stiffness(EA=3e3, GA=1e3, GJ=2.0, EI=(3.0, 300.0), mass=0.3, inertia=3e-4)
BEAM = tb.Beam.straight(1.0, 3, STRIP)
T = torch.linspace(0, 0.1, 3, dtype=DOUBLE)


def tip(wind, chord=0.2, engine="auto", **options):
    scene = tb.Scene(BEAM, [tb.StripAir(chord, wind=wind, lags=None)], **options)
    solution = tb.simulate(scene, T, step=0.02, engine=engine)
    assert (solution.status == 0).all()
    return solution.tip.position[-1]


def fields():
    steady = tb.Wind((0, -12.0, 0))
    values = torch.randn(2, 1, 2, 2, 3, dtype=DOUBLE, generator=torch.Generator().manual_seed(1))
    return {
        "shear": tb.Wind((0, -12.0, 1.0), exponent=0.3, height=2.0),
        "history": tb.Wind(tb.History((0.0, 0.1), ((0, -12.0, 0), (0, -12.0, 3.0)))),
        "gust": steady + tb.Gust((0, 0, 3.0), 0.5, speed=12.0, direction=(1, -2, 0)),
        "turbulence": tb.Turbulence((0, -12.0, 0), 1.0, 3.0, harmonics=4, seed=(1, 2)),
        "table": steady + tb.WindTable((0.0, 0.1), values, y=(-1.0, 1.0), z=(-1.0, 1.0)),
    }


@pytest.mark.parametrize(
    "name,tapered",
    [("shear", 0), ("history", 1), ("gust", 1), ("turbulence", 0), ("turbulence", 1), ("table", 1)],
)
def test_both_engines_blow_alike(name, tapered):
    """On a wing with one chord and with one that tapers."""
    wind, chord = fields()[name], tb.Table((0.0, 1.0), (0.25, 0.1)) if tapered else 0.2
    eager, native = (tip(wind, chord, engine=engine) for engine in ("eager", "compiled"))
    assert_close(eager, native, rtol=0, atol=1e-11)
    assert (eager - tip((0, -12.0, 0), chord, engine="eager")).abs().max() > 1e-6


@pytest.mark.parametrize("places", [2, 300], ids=["summed", "looked up"])
def test_a_table_of_a_gradient_has_it_at_its_places(places):
    """Velocity x along y of a table and of an induction: the derivative by place is 1 between
    places and at them, where the slopes of both sides once were added.
    """
    along = torch.linspace(-1, 1, 2 * places + 1, dtype=DOUBLE)
    values = torch.zeros(2, len(along), 1, 1, 3, dtype=DOUBLE)
    values[..., 0, 0, 1] = along
    table = tb.WindTable((0.0, 1.0), values, x=along)
    turning = tb.Induction(along + 2, 0 * along, -(along + 2))
    for x in (0.0, 0.3, 0.5):
        at = torch.tensor([[x, 0, 0]], dtype=DOUBLE, requires_grad=True)
        (slope,) = torch.autograd.grad(table.velocity(at, NOW)[0, 1], at)
        assert_close(slope, torch.tensor([[1.0, 0, 0]], dtype=DOUBLE), rtol=0, atol=1e-9)
        at = torch.tensor([[0.0, x + 2, 0]], dtype=DOUBLE, requires_grad=True)
        (slope,) = torch.autograd.grad(turning.velocity(at, NOW)[0, 2], at)
        assert_close(slope, torch.tensor([[0.0, 1, 0]], dtype=DOUBLE), rtol=0, atol=1e-9)


def test_a_turning_frame_meets_the_same_wind():
    """Drag by a sheared wind at a beam that a frame turns with, and at the same wind as a function
    of the place in frame a.
    """
    wind = tb.Wind((0, 5.0, 10.0), exponent=0.3, height=2.0)
    spin = 3.0

    def flow(position, t):
        c, s = torch.cos(spin * t), torch.sin(spin * t)
        turn = torch.stack((c, -s, 0 * c, s, c, 0 * c, 0 * c, 0 * c, 1 + 0 * c)).reshape(3, 3)
        return wind.velocity(position @ turn.T, t) @ turn

    def moved(given, engine="auto"):
        drag = tb.Drag(1.2, 0.3, flow=given)
        scene = tb.Scene(BEAM, [drag], frame=tb.Frame(angular_velocity=(0, 0, spin)))
        return tb.simulate(scene, T, step=0.02, engine=engine).tip.position[-1]

    assert_close(moved(wind), moved(flow), rtol=0, atol=1e-10)
    assert_close(moved(wind, "eager"), moved(wind), rtol=0, atol=1e-11)


def test_gradients_by_what_a_wind_is_made_of():
    """Against central differences, whose truncation is below 1e-7 of it."""
    makers = {
        "peak": (lambda v: tb.Wind((0, -12.0, 0)) + tb.Gust((0, 0, v), 0.5, speed=12.0), 3.0),
        "gradient": (lambda v: tb.Wind((0, -12.0, 0)) + tb.Gust((0, 0, 3.0), v, speed=12.0), 0.5),
        "exponent": (
            lambda v: tb.Wind((0, -12.0, 1.0), exponent=v, height=0.02, up=(0, 0, -1)),
            0.3,
        ),
        "sigma": (lambda v: tb.Turbulence((0, -12.0, 0), v, 3.0, harmonics=4), 1.0),
        "length": (lambda v: tb.Turbulence((0, -12.0, 0), 1.0, v, harmonics=4), 3.0),
    }
    for name, (make, value) in makers.items():
        engine = "auto" if name in ("gradient", "length") else "eager"
        v = torch.tensor(value, dtype=DOUBLE, requires_grad=True)
        (slope,) = torch.autograd.grad(tip(make(v), engine=engine)[2], v)
        h = 1e-5
        with torch.no_grad():
            up, down = (
                tip(make(torch.tensor(value + d, dtype=DOUBLE)), engine=engine)[2] for d in (h, -h)
            )
        assert_close(slope, (up - down) / (2 * h), rtol=1e-5, atol=1e-9, msg=name)
        assert slope.abs() > 1e-9, name


@refusals(
    (lambda: tb.Wind((1.0, 0, 0), exponent=0.2), "without a height"),
    (lambda: tb.Wind((1.0, 0, 0), height=2.0), "without an exponent or a roughness"),
    (lambda: tb.Wind((1.0, 0, 0), exponent=0.2, roughness=0.1, height=9.0), "one of them"),
    (lambda: tb.Wind((1.0, 0, 0), roughness=0.1, height=0.1), "within the roughness"),
    (lambda: tb.Wind((1.0, 0), exponent=0.2, height=9.0), r"\(\.\.\., 3\)"),
    (lambda: tb.Gust((0, 0, 1.0), -1.0, speed=1.0), "gradient = -1"),
    (lambda: tb.Gust((0, 0, 1.0), 1.0, speed=1.0, direction=(0, 0, 0)), "length 0"),
    (lambda: tb.Turbulence((1.0, 0, 0), 0.0, 1.0), "sigma = 0"),
    (lambda: tb.Turbulence((0, 0, 1.0), 1.0, 1.0), "along up"),
    (lambda: tb.Turbulence((1.0, 0, 0), 1.0, 1.0, spectrum="white"), "white"),
    (lambda: tb.Turbulence((1.0, 0, 0), 1.0, 1.0, band=(2, 1)), "rising"),
    (lambda: tb.Turbulence((1.0, 0, 0), 1.0, 1.0, seed=()), "no numbers"),
    (
        lambda: tb.Turbulence((1.0, 0, 0), 1.0, 1.0, spectrum="kaimal", isotropic=True),
        "von Karman's",
    ),
    (lambda: tb.WindTable((0.0, 1.0), torch.zeros(2, 1, 1, 3, 3), z=(0, 1.0)), "shape"),
    (lambda: tb.WindTable((0.0, 0.0), torch.zeros(2, 1, 1, 1, 3)), "increasing"),
)
def test_bad_winds_are_refused(make):
    make()


def test_an_added_mass_in_a_wind_is_refused():
    with pytest.raises(ValueError, match="uniform and steady"):
        tb.Drag(1.0, 0.1, added_mass=1.0, flow=tb.Wind((1.0, 0, 0)))


def test_what_a_follower_or_a_drive_takes_from_a_record_acts_natively():
    """A History of a follower force, and a SmoothHistory of a hinge's angle: both engines, where
    a function of t that is a tree once stood still natively.
    """
    record = tb.History((0.0, 0.1), ((0, 0, 0.0), (0, 0, 0.4)))
    angle = tb.SmoothHistory(
        torch.linspace(0, 0.2, 12), 3 * torch.linspace(0, 0.2, 12)[:, None] ** 2
    )

    def pushed(engine):
        scene = tb.Scene(BEAM, [tb.TipLoad(force=record, follower=True)])
        return tb.simulate(scene, T, step=0.02, engine=engine).tip.position[-1]

    def driven(engine):
        parts = {
            "a": tb.Beam.straight(1.0, 1, STRIP),
            "b": tb.Beam.straight(1.0, 1, STRIP, root=(1.0, 0, 0)),
        }
        hinge = tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0), angle=lambda t: angle(t)[0])
        tree = tb.Hinge(("a", -1), ("b", 0), axis=(0, 1, 0), angle=angle)
        return [
            tb.simulate(
                tb.Scene(parts, joints=[joint], supports=[tb.Support(("a", 0))]), T, step=0.02,
                engine=engine,
            )["b"].tip.position[-1].reshape(3)
            for joint in (hinge, tree)
        ]  # fmt: skip

    assert_close(pushed("eager"), pushed("compiled"), rtol=0, atol=1e-11)
    assert pushed("compiled")[2].abs() > 1e-6
    for engine in ("eager", "compiled"):
        function, tree = driven(engine)
        assert_close(function, tree, rtol=0, atol=1e-11)
        assert tree[2].abs() > 1e-6
