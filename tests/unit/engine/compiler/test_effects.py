"""Effects are traced as they stand: wrench and tangent of a load, the tangent by automatic
differentiation among them.
"""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from tests.cases.evaluate import evaluate
from tests.cases.nodal_cases import spd
from tests.cases.site_loads import lag, lagged, user, wind
from torchbeam.core.leaves import bound
from torchbeam.engine.compiler.trace import trace
from torchbeam.math import quaternions as quat
from torchbeam.scene import effects as fx
from torchbeam.scene.effects.load_point import together

T, INPUTS = torch.tensor(0.3), {"u": torch.tensor([0.1, -0.2, 0.3])}
MOTION = ("R", "position", "velocity", "spin", "internal")


EFFECTS = {
    "a follower": fx.PointLoad(1, force=(1.0, 2, 3), moment=(0.3, 0.2, 0.1), follower=True),
    "a line load": fx.LineLoad(force=(1.0, 2, 3), follower=True),
    "gravity": fx.Gravity((0.0, 0.1, -9.81)),
    "mass damping": fx.MassDamping(0.3),
    "drag": fx.Drag(1000.0, 0.1, normal=1.1, tangential=0.1, flow=wind),
    "a spring": fx.Spring(-1, 2.0, to=(0.1, 0.2, 0.3), length=0.5, damping=0.1),
    "a root spring": fx.RootSpring((2.0, 3.0), damping=(0.2, 0.1)),
    "a user's load": fx.Load(user, node=-1, inputs={"u": 3}),
    "a user's load along": fx.Load(user, node=None, inputs={"u": 3}),
    "a load with internal states": fx.Load(lagged, node=-1, internal=2, rate=lag),
}


def site_of(effect, batch):
    """Random, along the beam one site; turned by less than pi against the support."""
    lead = (batch, 1) if effect.node is None else (batch,)
    support = fx.Pose(torch.zeros(3), torch.eye(3), torch.full((3,), 0.1), torch.full((3,), 0.2))
    rotation = quat.matrix(quat.exponential(torch.randn(*lead, 3)))
    return fx.LoadPoint(
        rotation,
        spd(),
        *(torch.randn(*lead, 3) for _ in range(3)),
        s=torch.tensor([0.4]),
        support=support,
        axes=torch.eye(3),
        internal=torch.randn(*lead, 2),
        dt=torch.tensor(0.1),
        elements=1,
    )


@pytest.mark.parametrize("name", EFFECTS)
def test_effects_are_traced_as_they_stand(name):
    """Of one sample, evaluated for four others: to rounding."""
    torch.manual_seed(0)
    effect = bound(EFFECTS[name], torch.float64, T.device)
    one, four = site_of(effect, 1), site_of(effect, 4)

    def load(**motion):
        site = replace(one, **motion)
        return together(effect.wrench(site, T, INPUTS), site.R), effect.tangent(site, T, INPUTS)

    function = trace(load, {field: getattr(one, field)[0] for field in MOTION})
    found = evaluate(function, {field: getattr(four, field) for field in MOTION})
    wrench, tangent = load(**{field: getattr(four, field) for field in MOTION})
    for field, expected in {"0": wrench, **{f"1.{of}": by for of, by in tangent.items()}}.items():
        x = found[field]
        assert_close(x, expected.expand_as(x), rtol=1e-12, atol=1e-13 * float(expected.abs().max()))
