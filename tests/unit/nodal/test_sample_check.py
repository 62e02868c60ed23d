"""What users wrote gives each sample of a batch what its own motion asks, or is refused."""

import pytest
import torch

import torchbeam as tb
from torchbeam.extend import VELOCITY, LoadEffect

SECTION = tb.Section.from_stiffness(EA=1e4, GA=4e3, GJ=0.8, EI=1.0, mass=0.2)
BEAM = tb.Beam.straight(1.0, 2, SECTION)
ROWS = torch.tensor([1.0, 2.0, 3.0, 4.0])[:, None]
MIXED = "mixes the samples of a batch"
MIXING = {
    "mean": lambda r, v: r - r.mean(0),
    "roll": lambda r, v: v.roll(1, 0),
    "sort": lambda r, v: r.sort(0)[0],
    "descending sort": lambda r, v: r.sort(0, descending=True)[0],
    "sum so far": lambda r, v: v.cumsum(0),
    "largest": lambda r, v: v / (1 + v.abs().amax(0)),
    "number": lambda r, v: v / v.shape[0],
}
OWN = {
    "velocity": lambda r, v: v * v.norm(dim=-1, keepdim=True),
    "rows that it holds": lambda r, v: v * ROWS,
    "a draw": lambda r, v: torch.rand_like(v),
    "a number of rows": lambda r, v: v + torch.zeros(4, 3),
}


def stepped(load, batch=4, engine="eager"):
    scene = tb.Scene(BEAM, [tb.TipLoad(force=(0, 0, 0.1)), load])
    return tb.Stepper(scene, 0.01, engine=engine)(tb.rest(scene, (batch,)))


def of(function, **more):
    more = {"node": -1, **more}
    return tb.Load(lambda r, R, v, w, t, **named: (-function(r, v), None), **more)


@pytest.mark.parametrize("name", MIXING)
def test_functions_that_mix_samples_are_refused(name):
    with pytest.raises(ValueError, match=f"function '<lambda>' was given, which {MIXED}"):
        stepped(of(MIXING[name], of=("position", "velocity")))


def test_native_steps_refuse_them_too():
    pytest.importorskip("llvmlite")
    with pytest.raises(ValueError, match=MIXED):
        stepped(of(MIXING["mean"], of=("position",)), engine="compiled")


@pytest.mark.parametrize("name", OWN)
def test_functions_of_a_sample_are_taken(name):
    stepped(of(OWN[name], of=("position", "velocity")))


def test_one_sample_is_nothing_to_mix():
    stepped(of(MIXING["mean"], of=("position",)), batch=1)


def test_rates_values_and_inputs_are_looked_at():
    def rate(z, r, R, v, w, t):
        return v - z.mean(0)

    def lag(r, R, v, w, t, z):
        return -z, None

    with pytest.raises(ValueError, match=MIXED):
        stepped(tb.Load(lag, node=-1, rate=rate, internal=3, of=("velocity",)))

    def scaled(r, R, v, w, t, c):
        return -(c / c.sum(0))[..., None] * v, None

    with pytest.raises(ValueError, match=MIXED):
        stepped(tb.Load(scaled, node=-1, of=("velocity",), values={"c": torch.ones(4)}))

    def pushed(r, R, v, w, t, u):
        return u - u.mean(0), None

    scene = tb.Scene(BEAM, [tb.Load(pushed, node=-1, of=(), inputs={"u": 3})])
    with pytest.raises(ValueError, match=MIXED):
        tb.Stepper(scene, 0.01, engine="eager")(tb.rest(scene, (4,)), u=torch.zeros(4, 3))


def test_a_class_and_a_flow_are_looked_at():
    class Flock(LoadEffect):
        node = None
        depends = frozenset({VELOCITY})

        def wrench(self, point, t, inputs):
            return point.velocity.mean(0) - point.velocity, None

    with pytest.raises(ValueError, match=f"class Flock was given, which {MIXED}"):
        stepped(Flock())

    def flow(position, t):
        return position - position.mean(0)

    with pytest.raises(ValueError, match=f"Drag with the function 'flow' was given, which {MIXED}"):
        stepped(tb.Drag(1.0, 0.1, flow=flow))


def test_it_is_asked_no_more_afterwards():
    calls = []

    def counted(r, R, v, w, t):
        calls.append(1)
        return -v, None

    load = tb.Load(counted, node=-1, of=("velocity",))
    stepped(load)
    first = len(calls)
    calls.clear()
    stepped(load)
    assert 0 < len(calls) < first
    again = len(calls)
    calls.clear()
    stepped(load)
    assert len(calls) == again
