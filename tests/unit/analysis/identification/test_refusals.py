"""What identify and Measurement refuse, in one sentence each."""

import math

import pytest
import torch
from torch.distributions import Dirichlet, HalfNormal, Normal

import torchbeam as tb
from tests.cases.refusals import refusals
from tests.cases.wave_cases import CLEAN, T, wave


def parameter(**changed):
    return {"a": 1.0, "b": tb.Parameter(**{**dict(start=1.0), **changed})}


# fmt: off
CASES = {
    "all NaN": (lambda: dict(data=T * math.nan), "data of 40 numbers, all NaN"),
    "infinite": (lambda: dict(data=T / 0), "data hold infinite"),
    "complex": (lambda: dict(data=T + 0j), r"complex data were given; real ones, as shape\.real"),
    "too few": (lambda: dict(data=CLEAN[:1], model=lambda t: wave(t)[:, :1]),
                "1 data were given for 2 parameters"),
    "another shape": (lambda: dict(model=lambda t: wave(t)[:, :3]),
                      r"gave \(5, 3\) for 5 samples was given; \(5, 40\)"),
    "no batch": (lambda: dict(model=lambda t: wave(t)[0]), r"a model that gave \(40,\)"),
    "no tensor": (lambda: dict(model=lambda t: 3.0), "a model that gave a float"),
    "no function": (lambda: dict(model=3.0),
                    "a model = 3.0 was given; a function of theta is wanted"),
    "no status": (lambda: dict(model=lambda t: (wave(t), torch.ones(2, dtype=torch.long))),
                  r"a status \(2,\)"),
    "no parameters": (lambda: dict(start={}), "no parameters were given"),
    "a parameter without numbers": (lambda: dict(start=parameter(start=torch.zeros(0))),
                                    r"a start of shape \(0,\), without numbers"),
    "a name that is none": (lambda: dict(start={1: 2.0}), "a parameter named 1"),
    "names beside names": (lambda: dict(names=("a", "b")), "beside parameters by name"),
    "logit": (lambda: dict(start=parameter(transform="logit")), "'logit' was given without bounds"),
    "sqrt": (lambda: dict(start=parameter(transform="sqrt")), "transform = 'sqrt'"),
    "negative log": (lambda: dict(start=parameter(start=-1.0, transform="log")),
                     "a start by its logarithm = -1"),
    "outside": (lambda: dict(start=parameter(bounds=(2.0, 3.0))),
                "bounds from 2 to 3 were given for a start of 1"),
    "prior of vectors": (lambda: dict(start=parameter(prior=Dirichlet(torch.ones(2)))),
                         "of single numbers"),
    "outside the prior": (lambda: dict(start=parameter(prior=HalfNormal(1.0), start=-1.0)),
                          "which the prior"),
    "a prior without sigma": (lambda: dict(start=parameter(prior=Normal(1.0, 0.1))),
                              "priors were given with data without"),
    "a scale of three": (lambda: dict(start=parameter(scale=torch.ones(3))),
                         r"scale of shape \(3,\)"),
    "bounds of three": (lambda: dict(start=parameter(bounds=(torch.zeros(3), 2.0))),
                        r"bounds of shape \(3,\)"),
    "a prior of three": (lambda: dict(start=parameter(prior=Normal(torch.ones(3), 1.0))),
                         "a prior of shape .3,"),
    "own of one": (lambda: dict(start=parameter(own=True)),
                   "own to each experiment, was given with one"),
    "names of experiments": (lambda: dict(model={"x": wave}, data={"y": CLEAN}),
                             "models of x and data of y"),
    "models without": (lambda: dict(model={"x": wave}), "data without names"),
    "sigma of no data": (lambda: dict(data={"x": CLEAN}, sigma={"y": 0.1}),
                         "sigma of y was given; there are data of x"),
    "bounds of the adjoint": (lambda: dict(start=parameter(bounds=(0.0, 2.0)),
                                           derivatives="adjoint"), "but by .* 'logit'"),
    "sigma twice": (lambda: dict(data=tb.Measurement(CLEAN, 0.1), sigma=0.1),
                    "beside a Measurement"),
    "sigma here and there": (lambda: dict(data={"x": tb.Measurement(CLEAN, 0.1), "y": CLEAN}),
                             "all or none"),
    "follow": (lambda: dict(starts=3, follow=0), "follow = 0"),
    "starts": (lambda: dict(starts=0), "starts = 0"),
    "spread": (lambda: dict(starts=3, spread=0.5), "spread = 0.5"),
    "a sensor without a solution": (lambda: dict(data=tb.Measurement(CLEAN, 0.1, T,
        tb.sensors.Spin(-1)["y"], name="gyro")),
                                    r"a Measurement that has a sensor \('gyro'\), by which a "
                                    r"Solution or a State is read"),
    "an unknown delay": (lambda: dict(data=tb.Measurement(CLEAN, 0.1, T, tb.sensors.Spin(-1)["y"],
                                                          delay="late")), "'late'"),
}
# fmt: on


@pytest.mark.parametrize("name", CASES)
def test_refused(name):
    given = dict(model=wave, data=CLEAN, start={"a": 1.0, "b": 1.0})
    changed, sentence = CASES[name]
    with pytest.raises(ValueError, match=sentence):
        tb.identify(**{**given, **changed()})


MEASUREMENTS = {
    "times": (dict(times=T[:3]), r"times of shape \(3,\) were given for data of shape \(40,\)"),
    "a rate without times": (dict(sensor=tb.sensors.TipPosition(), rate=True), "without times"),
    "sigma": (dict(sigma=torch.ones(3)), r"sigma of shape \(3,\)"),
    "offset": (dict(offset=1.0), "offset = 1.0"),
    "a delay of readings": (
        dict(times=T, delay=0.1),
        "delay was given to a Measurement without a sensor",
    ),
    "a clock of readings": (dict(times=T, clock="c", rate=True), "clock and rate was given"),
}


@refusals(MEASUREMENTS)
def test_a_measurement_is_refused(changed):
    tb.Measurement(CLEAN, **changed)
