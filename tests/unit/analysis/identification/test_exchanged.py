"""Markers and channels that were exchanged are named by the fit, others are not."""

import warnings

import pytest
import torch

import torchbeam as tb

T = torch.linspace(0, 1, 40)
PLACES = torch.tensor([0.3, 0.6, 0.7, 1.0])


def readings(theta):
    """Four markers (x, y) on a swinging line: (N, times, markers, 2)."""
    angle = theta["a"][:, None] * torch.sin(6 * T) + theta["b"][:, None] * T
    axis = torch.stack((torch.cos(angle), torch.sin(angle)), -1)
    return axis[:, :, None] * PLACES[:, None] * theta["length"][:, None, None, None]


START = {"a": 0.4, "b": 0.1, "length": 1.1}
TRUE = {"a": torch.tensor([0.5]), "b": torch.tensor([0.2]), "length": torch.tensor([1.0])}


def seen(seed=0):
    noise = torch.randn(40, 4, 2, generator=torch.Generator().manual_seed(seed))
    return readings(TRUE)[0] + 0.003 * noise


def fitted(values, **options):
    m = tb.Measurement(values, 0.003, times=T, name="markers", **options)
    return tb.identify(readings, m, START)


def exchanged(fit):
    return [hint for hint in fit.hints if "seem to be exchanged" in hint]


@pytest.mark.parametrize("options", [{}, {"offset": True}, {"noise": "ar1"}, {"noise": "blocks"}],
                         ids=str)  # fmt: skip
def test_markers_all_along(options):
    values = seen()
    values[:, [1, 3]] = values[:, [3, 1]]
    (hint,) = exchanged(fitted(values, **options))
    assert "'markers 1' and 'markers 3' seem to be exchanged: " in hint
    assert exchanged(fitted(seen(), **options)) == []


def test_markers_for_a_while_and_missing_readings():
    values = seen()
    values[12:25, [0, 3]] = values[12:25, [3, 0]]
    values[15, 0] = torch.nan
    (hint,) = exchanged(fitted(values))
    assert "'markers 0' and 'markers 3' seem to be exchanged from 0.3077 to 0.6154 s" in hint


def test_channels_of_a_measurement_and_measurements():
    def model(theta):
        y = readings(theta)
        return y[:, :, 3], y[:, :, 1], y[:, :, 0]

    values = seen()
    parts = [tb.Measurement(values[:, k], times=T, name=f"marker {k}") for k in (3, 1, 0)]
    assert exchanged(tb.identify(model, parts, START)) == []
    swapped = [parts[1], parts[0], parts[2]]
    (hint,) = exchanged(tb.identify(model, swapped, START))
    assert "'marker 1' and 'marker 3' seem to be exchanged" in hint
    turned = [tb.Measurement(parts[0].values.flip(1), times=T, name="tip"), *parts[1:]]
    (hint,) = exchanged(tb.identify(model, turned, START))
    assert "'tip 0' and 'tip 1' seem to be exchanged" in hint


def test_no_alarm_of_what_is_right_or_errs_otherwise():
    """Twelve draws of noise; two markers at nearly one place; a model that misses something."""
    for seed in range(12):
        assert exchanged(fitted(seen(seed))) == []
    alike = seen()
    alike[:, 2] = seen(1)[:, 1]
    assert exchanged(fitted(alike)) == []
    assert exchanged(fitted(seen() + 0.05 * torch.sin(20 * T)[:, None, None])) == []


@pytest.mark.parametrize("pair", [(), (0, 1), (2, 3), (1, 3)], ids=str)
def test_offsets_that_take_it_up_become_alike(pair):
    """Markers that cameras see from an origin of their own, on a body that moves and turns a
    little: with offsets of each channel an exchange changes the misfit by less than half, but
    leaves offsets of two markers far apart. Cameras whose offsets are apart are none.
    """
    places = torch.tensor([[0.3, 0.0], [0.6, 0.1], [0.7, -0.1], [1.0, 0.05]])

    def model(theta):
        angle = theta["a"][:, None] * torch.sin(6 * T)
        c, s = torch.cos(angle), torch.sin(angle)
        turn = torch.stack((torch.stack((c, -s), -1), torch.stack((s, c), -1)), -2)
        along = theta["b"][:, None] * torch.sin(9 * T)
        return torch.einsum("ntij,mj->ntmi", turn, places) + along[..., None, None]

    true = {"a": torch.tensor([0.05]), "b": torch.tensor([0.2])}
    noise = 0.005 * torch.randn(40, 4, 2, generator=torch.Generator().manual_seed(0))
    zero = torch.tensor([[0.4, -0.2]]) if pair else 60 * noise[0]
    values = model(true)[0] + noise + zero
    values[:, pair] = values[:, pair[::-1]]
    m = tb.Measurement(values, 0.005, times=T, offset=True, name="markers")
    said = exchanged(tb.identify(model, m, {"a": 0.04, "b": 0.15}))
    if not pair:
        assert said == []
    else:
        (hint,) = said
        i, j = pair
        assert hint.startswith(f"'markers {i}' and 'markers {j}' seem to be exchanged: ")
        assert hint.endswith("of what it is, and their offsets alike")


def swing(theta):
    """Place m and acceleration m/s^2 of a swing that fades from a known speed, (n, times) each."""
    times, c, w = torch.linspace(0, 2, 120), theta["c"][:, None], theta["w"][:, None]
    place = 0.01 * torch.exp(-c * times) * torch.sin(w * times)
    rest = 0.02 * c * w * torch.exp(-c * times) * torch.cos(w * times)
    return place, (c * c - w * w) * place - rest


def swings(factors, sigma=(1e-6, 2e-2), wrong=False):
    """The fit of two instruments whose readings are so many times too small."""
    true = swing({"c": torch.tensor([0.3]), "w": torch.tensor([9.0])})
    random = torch.Generator().manual_seed(0)
    data = [
        (y[0] + s * torch.randn(y[0].shape, generator=random)) / f
        for y, s, f in zip(true, (1e-6, 2e-2), factors, strict=True)
    ]
    if wrong:
        data.reverse()
    t = torch.linspace(0, 2, 120)
    measured = [
        tb.Measurement(d, s, t, name=name)
        for d, s, name in zip(data, sigma, ("laser", "accelerometer"), strict=True)
    ]
    with warnings.catch_warnings():  # of units
        warnings.simplefilter("ignore")
        return tb.identify(swing, measured, {"c": 0.2, "w": 8.8})


@pytest.mark.parametrize(
    "factor, own, word",
    [
        (-1.0, False, "another sign"),
        (9.80665, False, "g for m/s^2"),
        (9.80665, True, "g for m/s^2"),
        (1 / 9.80665, True, "m/s^2 for g"),
        (1e3, False, "m for mm"),
        (1e-3, True, "mm for m"),
    ],
)
def test_another_sign_or_unit_is_named(factor, own, word):
    """Of an accelerometer beside a laser that holds the parameters; `own`: its sigma is in the unit
    of its data.
    """
    fit = swings((1.0, factor), (1e-6, 2e-2 / abs(factor) if own else 2e-2))
    assert fit.doubts[0].startswith(f"'accelerometer' fits {factor:.4g} times its readings ({word}")
    assert not any("fits" in doubt for doubt in swings((1.0, 1.0)).doubts)


def test_what_goes_against_the_model_from_the_start_on():
    """Of an amplitude that is positive nothing is determined: hint and refusal say what the start
    said.
    """
    times = torch.linspace(0, 1, 50)

    def model(theta):
        return theta["a"][:, None] * torch.sin(6 * times)

    data = tb.Measurement(-0.9 * torch.sin(6 * times), 0.01, times, name="laser")
    fit = tb.identify(model, data, {"a": tb.Parameter(1.0, "log")})
    assert fit.status != 0 and any("sign another" in hint for hint in fit.hints)
    with pytest.raises(ValueError, match=r"determines nothing .*sign another"):
        fit.refined(model)


def test_instruments_of_two_kinds_that_are_exchanged():
    hints = swings((1.0, 1.0), wrong=True).hints
    assert any("'laser' and 'accelerometer' seem to be exchanged" in hint for hint in hints)
    assert not any("exchanged" in hint for hint in swings((1.0, 1.0)).hints)
