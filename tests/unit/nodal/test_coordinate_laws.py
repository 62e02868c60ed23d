"""Laws along coordinates that say by themselves what they resist by: a new one is one class."""

from dataclasses import dataclass

import torch
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.core.leaves import leaf
from torchbeam.core.validation import Value
from torchbeam.nodal.coordinate_laws import coordinate_laws_of
from torchbeam.scene.coordinate_law import Response, Travel, rows
from torchbeam.scene.hysteresis import HystereticLaw


@dataclass(frozen=True)
class Fatigue(HystereticLaw):
    """A spring that softens with the energy that has gone through it."""

    stiffness: Value = leaf(rows, positive=True)

    def response(self, travel: Travel) -> Response:
        before, after, memory, *_ = travel
        k = self.stiffness / (1 + memory[..., 0])
        mean = after if travel.dt is None else (before + after) / 2
        worn = memory[..., 0] + 10 * (after - before).abs()
        after_memory = torch.stack((worn, memory[..., 1]), -1)
        return Response(k * mean, k * (1 if travel.dt is None else 0.5), after_memory)


def bodies(*laws, torque=1.0):
    names = [f"wheel {k}" for k in range(len(laws))]
    parts = {n: tb.Body(mass=1.0, inertia=0.1, position=(k, 0, 0)) for k, n in enumerate(names)}
    pairs = zip(names, laws, strict=True)
    joints = [tb.Hinge(None, n, axis=(0, 0, 1), torque=torque, hysteresis=x) for n, x in pairs]
    return tb.Scene(parts, joints=joints, plane="xy")


def test_a_new_law_is_one_class_for_both_engines():
    """Beside laws of other classes and joints without one; with its gradient."""
    answers = []
    for engine in ("eager", "compiled"):
        k = torch.tensor(5.0, dtype=torch.float64, requires_grad=True)
        scene = bodies(Fatigue(k), tb.ElastoPlastic(5.0, 0.1), None)
        stepper = tb.Stepper(scene, 0.05, engine=engine, tolerance=1e-13)
        state = stepper.rest()
        for _ in range(4):
            state = stepper(state)
        (slope,) = torch.autograd.grad(state.joints[0, 0] + state.joints[0, 12], k)
        answers.append((state.joints.detach(), slope))
    for eager, native in zip(*answers, strict=True):
        assert_close(native, eager, rtol=1e-9, atol=1e-12)
    (joints, slope), _ = answers
    assert joints[0, 12] > 0.01 and slope < 0
    assert (joints[2, 12:] == 0).all() and joints.shape[-1] == 12 + 3


def test_each_joint_has_its_own_law():
    """Of all joints at once what each gives alone, and nothing where there is none."""
    laws = tb.ElastoPlastic(5.0, 0.1), None, tb.BoucWen(3.0, 0.2), tb.ElastoPlastic(7.0, 0.3)
    joints = bodies(*laws).joints
    own = coordinate_laws_of(joints, torch.zeros((), dtype=torch.float64))
    assert own.kinds == [(0,), (), (1,), (0,)] and own.memory == 3
    before = torch.zeros(4, dtype=torch.float64)
    after = torch.tensor([0.1, 0.1, -0.05, 0.02], dtype=torch.float64)
    step = torch.ones(1, dtype=torch.float64)
    whole = own.response(Travel(before, after, before.new_zeros(4, 3), before[0], step))
    for k, joint in enumerate(joints):
        if joint.hysteresis is None:
            assert whole.load[k] == 0 and (whole.memory[k] == 0).all()
            continue
        memory = before.new_zeros(joint.hysteresis.memory)
        alone = joint.hysteresis.response(Travel(before[k], after[k], memory, before[0], step))
        assert_close(whole.load[k], alone.load, rtol=1e-14, atol=0)
        assert_close(whole.memory[k, : len(memory)], alone.memory, rtol=1e-14, atol=0)
    assert coordinate_laws_of(bodies(None, None).joints, before[0]) is None
