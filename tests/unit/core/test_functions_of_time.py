"""Functions of time, wherever a scene takes one: what they may return, their gradients, each sample
at its own time, rates.
"""

import math
from dataclasses import replace

import pytest
import torch
from torch.autograd import forward_ad
from torch.autograd.graph import saved_tensors_hooks
from torch.testing import assert_close

import torchbeam as tb
from torchbeam.core.functions_of_time import at_time, rate_along
from torchbeam.dynamics.explicit import ExplicitStepper
from torchbeam.math import quaternions as quat

torch.set_default_dtype(torch.float64)

SECTION = tb.Section.from_stiffness(EA=50.0, GA=20.0, GJ=0.3, EI=0.4, mass=1.0, inertia=0.02)
A = torch.tensor(0.3)


def beam(N=2):
    return tb.Beam.straight(1.0, N, SECTION)


def scene(*effects, **options):
    """A beam that bends, so that every load has something to turn."""
    return tb.Scene(beam(), [tb.TipLoad(force=(0, 0.1, 0)), *effects], **options)


def across(a, t):
    """(0, 0, a sin 9t) as a user writes it; a batch where a is one."""
    return 0.0, 0.0, a * torch.sin(9 * t + 1)


KINDS = {
    "TipLoad": lambda a: scene(tb.TipLoad(force=lambda t: across(a, t))),
    "follower": lambda a: scene(
        tb.PointLoad(node=1, moment=lambda t: list(across(a, t)), follower=True)
    ),
    "LineLoad": lambda a: scene(tb.LineLoad(force=lambda t: across(a, t))),
    "Along": lambda a: scene(
        tb.LineLoad(
            force=tb.Along(lambda s, t: (0 * s, 0.0, a[..., None] * s * torch.sin(9 * t + 1)))
        )
    ),
    "PerElement": lambda a: scene(
        tb.LineLoad(force=tb.PerElement(lambda t: (across(a, t), (0.0, 0.1, 0.0))))
    ),
    "Frame velocity": lambda a: scene(
        tb.Drag(1.0, 0.5), frame=tb.Frame(velocity=lambda t: across(a, t))
    ),
    "Frame": lambda a: scene(frame=tb.Frame(angular_velocity=lambda t: across(a, t))),
    "RootMotion": lambda a: scene(root=tb.RootMotion(displacement=lambda t: across(a, t))),
    "rotation": lambda a: scene(root=tb.RootMotion(rotation=lambda t: across(a, t))),
    "RootSpring": lambda a: scene(
        tb.RootSpring((3.0, 2.0), (0.1, 0.1)), root=tb.RootMotion(lambda t: across(a, t))
    ),
    "Support": lambda a: scene(
        supports=[tb.Support(0), tb.Support(-1, "z", "", displacement=lambda t: across(a, t))]
    ),
    "turn": lambda a: scene(supports=[tb.Support(0), tb.Support(-1, turn=lambda t: across(a, t))]),
    "Actuation": lambda a: scene(tb.Actuation(curvature=lambda t: across(a, t))),
    "Actuation of elements": lambda a: scene(
        tb.Actuation(curvature=tb.PerElement(lambda t: [across(a, t), (0.0, 0.0, 0.0)]))
    ),
    "Spring": lambda a: scene(
        tb.Spring(-1, 2.0, to=lambda t: across(a, t), length=0.2, damping=0.1)
    ),
    "Drag": lambda a: scene(
        tb.Drag(
            1.0, 0.5, flow=lambda r, t: (0 * r[..., 0], 0.5, a[..., None] * torch.sin(9 * t + 1))
        )
    ),
    "Load": lambda a: scene(
        tb.Load(
            lambda r, R, v, w, t: ([0.0, -0.1 * r[..., 1], a * torch.sin(9 * t + 1)], None),
            node=-1,
            of="position",
        )
    ),
    "Load along": lambda a: scene(
        tb.Load(
            lambda r, R, v, w, t: (None, (0 * r[..., 0], 0.0, a[..., None] * torch.sin(9 * t + 1))),
            node=None,
            of="position",
        )
    ),
    "Load's rate": lambda a: scene(
        tb.Load(
            lambda r, R, v, w, t, z: ((0.0, 0.0, z[..., 0]), None),
            node=-1,
            internal=1,
            of=(),
            rate=lambda z, r, R, v, w, t: [a * torch.sin(9 * t + 1) - 3 * z[..., 0]],
        )
    ),
    "input": lambda a: (scene(tb.TipLoad(force=tb.Input("u", 3))), {"u": lambda t: across(a, t)}),
}


def parts(kind, a):
    made = KINDS[kind](a)
    return made if isinstance(made, tuple) else (made, {})


def reading(state):
    """One number of all that has moved."""
    return (
        state.position[..., 1:, :].mul(torch.tensor([1.0, 2.0, 3.0])).sum((-1, -2))
        + state.velocity[..., 1:, 2].sum(-1) / 9
    )


TIMES = torch.tensor([0.02, 0.09])


def end(kind, a=A, times=TIMES, **options):
    made, inputs = parts(kind, a)
    return reading(tb.simulate(made, times, inputs=inputs, **options).state[-1])


def check(function, *xs, most=1e-6, gap=1e-5):
    """Reverse mode against central differences in each number, relative to the largest; their error
    is gap^2 of the third derivative, and 1e-13/gap of solves.
    """
    xs = [x.detach().clone().requires_grad_() for x in xs]
    slopes = torch.cat([g.flatten() for g in torch.autograd.grad(function(*xs).sum(), xs)])
    sizes = [x.numel() for x in xs]
    with torch.no_grad():

        def at(flat):
            return function(
                *(part.view(x.shape) for part, x in zip(flat.split(sizes), xs, strict=True))
            ).sum()

        flat = torch.cat([x.flatten() for x in xs])
        want = torch.stack(
            [(at(flat + gap * e) - at(flat - gap * e)) / (2 * gap) for e in torch.eye(len(flat))]
        )
    assert want.abs().min() > 1e-5, "a derivative that is none proves nothing"
    assert_close(slopes, want, rtol=0, atol=most * want.abs().max().item())


MIDPOINT = dict(step=0.04, tolerance=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_gradient_through_functions(kind):
    """By a tensor in the tuple or list that a function returns, and by every output time, the first
    included.
    """
    check(lambda a, t: end(kind, a, t, **MIDPOINT), A, TIMES)


# of the other ways to march: one of each mechanism
SAME = ("TipLoad", "Frame", "RootMotion", "Load")
ALPHA = dict(method="generalized_alpha", **MIDPOINT)
MARCHES = {
    "generalized_alpha": (ALPHA, ("TipLoad", "RootMotion", "input")),
    "checkpoint": (dict(checkpoint=True, **MIDPOINT), ("TipLoad", "Frame", "RootMotion", "input")),
    "rk4": (dict(method="rk4"), (*SAME, "input")),
    "dopri5": (dict(method="dopri5", rtol=1e-4), ("TipLoad",)),
    "minimal": (dict(form="minimal", method="rk4"), ("TipLoad", "Frame", "rotation", "input")),
    "block_rate": (
        dict(form="block_rate", method="rk4"),
        ("TipLoad", "Frame", "rotation", "input"),
    ),
}
CASES = [(kind, march) for march, (_, kinds) in MARCHES.items() for kind in kinds]


def told(cases, *short):
    """All cases, those that are not `short` as long runs: the gradient fuzz has any motion in any
    march.
    """
    return [pytest.param(*case, marks=[pytest.mark.long] * (case not in short)) for case in cases]


@pytest.mark.parametrize(
    "kind, march",
    told(
        CASES,
        ("RootMotion", "generalized_alpha"),
        ("input", "generalized_alpha"),
        ("Frame", "checkpoint"),
        ("TipLoad", "dopri5"),
        ("TipLoad", "rk4"),
        ("Load", "rk4"),
        ("input", "minimal"),
        ("rotation", "minimal"),
        ("Frame", "block_rate"),
    ),
)
def test_gradients_of_every_march(kind, march):
    """By the parameter and by the times, in the other methods and forms; steps that adapt are no
    function of them, to the tolerance that they keep.
    """
    options = MARCHES[march][0]
    check(
        lambda a, t: end(kind, a, t, **options), A, TIMES, most=1e-3 if "rtol" in options else 1e-6
    )


@pytest.mark.parametrize(
    "kind, march",
    told(
        [case for case in CASES if "dopri5" not in case]
        + [
            (kind, march)
            for march in ("minimal", "block_rate")
            for kind in ("Along", "PerElement", "Drag", "Load along")
        ],
        ("RootMotion", "generalized_alpha"),
        ("RootMotion", "checkpoint"),
        ("Load", "rk4"),
        ("input", "rk4"),
        ("Frame", "minimal"),
        ("Drag", "minimal"),
        ("Along", "minimal"),
        ("Load along", "minimal"),
        ("PerElement", "minimal"),
        ("Frame", "block_rate"),
    ),
)
def test_dual_numbers_of_every_march(kind, march):
    """torch.autograd.forward_ad, which nests in nothing: by the parameter and the times, as
    backward; a load's function of more than t included.
    """
    xs = [x.clone().requires_grad_() for x in (A, TIMES)]
    slopes = torch.autograd.grad(end(kind, *xs, **MARCHES[march][0]), xs)
    with forward_ad.dual_level():
        duals = [forward_ad.make_dual(x.detach(), torch.ones_like(x)) for x in xs]
        tangent = forward_ad.unpack_dual(end(kind, *duals, **MARCHES[march][0])).tangent
    assert_close(tangent, sum(x.sum() for x in slopes), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", ["RootMotion", "Drag"])
def test_dual_numbers_beside_saved_tensor_hooks_are_refused(kind):
    """Where torch has no derivative within them, the sentence says so, and blames nobody's
    function.
    """
    with forward_ad.dual_level():
        a = forward_ad.make_dual(A, torch.ones_like(A))
        with (
            pytest.raises(
                ValueError,
                match=r"dual numbers of torch\.autograd\.forward_ad were given beside hooks",
            ),
            saved_tensors_hooks(lambda saved: saved, lambda saved: saved),
        ):
            end(kind, a, **MIDPOINT)


STEPPERS = {
    "midpoint": lambda s: tb.Stepper(s, 0.03, tolerance=1e-12),
    "generalized_alpha": lambda s: tb.Stepper(s, 0.03, "generalized_alpha", tolerance=1e-12),
    "rk4": lambda s: ExplicitStepper(s, 0.03, "rk4", "nodal"),
    "minimal": lambda s: ExplicitStepper(s, 0.03, "rk4", "minimal"),
    "block_rate": lambda s: ExplicitStepper(s, 0.03, "rk4", "block_rate"),
}


def steps(kind, a, t, method, dt=None, count=2):
    """Two steps from the time t, 0-dim or one of each sample, of a beam that moves."""
    made, inputs = parts(kind, a)
    stepper = STEPPERS[method](made)
    held = {name: torch.tensor([0.0, 0.1, 0.2]) for name in inputs}
    start, more = stepper.rest(t.shape), {} if dt is None else dict(dt=dt)
    if isinstance(start, tb.State):
        start = tb.rest(made, t.shape, t)  # on supports that move
    else:
        start = replace(start, t=t.expand(start.t.shape), V=start.V + torch.tensor([0.0, 0.1, 0.2]))
    for _ in range(count):
        start = stepper(start, **held, **more)
    assert not start.status.any()
    return start


OWN = [(kind, "midpoint") for kind in KINDS if kind != "input"] + [
    (kind, method)
    for method in STEPPERS
    for kind in ("TipLoad", "Frame", "RootMotion", "rotation")
    if method != "midpoint" and (method, kind) != ("generalized_alpha", "Frame")
]


SLOW = [
    (kind, method)
    for kind in ("RootMotion", "rotation")
    for method in ("minimal", "block_rate", "rk4")
    if (kind, method) != ("RootMotion", "minimal")
]


@pytest.mark.parametrize("kind, method", told(OWN, *(case for case in OWN if case not in SLOW)))
def test_each_sample_at_its_own_time(kind, method):
    """A batch whose samples stand at other times, its parameters one of each: every sample moves as
    alone.
    """
    a, t = torch.tensor([0.3, 0.2, -0.4]), torch.tensor([0.1, 0.5, 0.1])
    together = steps(kind, a, t, method)
    for k in (1, 2):
        alone = steps(kind, a[k], t[k], method)
        for name in ("position", "velocity", "spin", "reaction", "t"):
            got, want = getattr(together, name)[k], getattr(alone, name)
            assert_close(got, want, rtol=1e-9, atol=1e-10 * (1 + want.norm().item()))


@pytest.mark.parametrize("kind", ["TipLoad", "RootMotion", "Load along", "Spring"])
def test_two_axes_of_samples_at_their_own_times(kind):
    a, t = torch.tensor([[0.3], [0.2]]), torch.tensor([[0.1, 0.5, 0.1], [0.2, 0.7, 0.1]])
    together = steps(kind, a, t, "midpoint", count=1)
    for i, j in torch.cartesian_prod(*map(torch.arange, t.shape)):
        alone = steps(kind, a[i, 0], t[i, j], "midpoint", count=1)
        assert_close(reading(together)[i, j], reading(alone), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    "kind, method",
    told(
        [
            *((kind, "midpoint") for kind in SAME),
            *(
                (kind, method)
                for method in STEPPERS
                for kind in ("TipLoad", "RootMotion")
                if method != "midpoint"
            ),
        ],
        *((kind, "midpoint") for kind in SAME),
        ("RootMotion", "generalized_alpha"),
        ("TipLoad", "rk4"),
        ("TipLoad", "minimal"),
    ),
)
def test_gradient_by_the_samples_own_times(kind, method):
    """Also where samples stand at one time: each sample's own derivative, the samples knowing
    nothing of each other.
    """
    t, gap = torch.tensor([0.3, 0.3, 0.5], requires_grad=True), 1e-5
    for times in (t, t[:2]):
        weight = torch.tensor([1.0, -2.0, 3.0])[: len(times)]
        (slope,) = torch.autograd.grad((weight * reading(steps(kind, A, times, method))).sum(), t)
        with torch.no_grad():
            want = (
                reading(steps(kind, A, times + gap, method))
                - reading(steps(kind, A, times - gap, method))
            ) / (2 * gap)
        want = want * weight
        assert want.abs().min() > 1e-4
        assert_close(slope[: len(times)], want, rtol=0, atol=1e-6 * want.abs().max().item())


@pytest.mark.parametrize("kind", SAME)
def test_gradient_by_the_step(kind):
    check(lambda dt: reading(steps(kind, A, torch.tensor(0.1), "midpoint", dt)), torch.tensor(0.03))


def test_gradient_by_the_steppers_step():
    """Of the constructor too, where nothing else carries gradient."""
    made = scene()
    for method in ("midpoint", "generalized_alpha"):

        def moved(dt, method=method):
            stepper = tb.Stepper(made, dt, method, tolerance=1e-12)
            return reading(stepper(stepper(stepper.rest())))

        check(moved, torch.tensor(0.03))
    with pytest.raises(ValueError, match="one number of seconds"):
        tb.Stepper(made, torch.ones(2))


def test_part_of_a_batch_at_their_own_times():
    """So many samples (70) that those which take longer, a few that are pushed hard, go on by
    themselves in smaller steps.
    """
    count = 70
    a, t = torch.full((count,), 0.01), torch.linspace(0, 1, count)
    a[::9] = 20.0
    together = tb.Stepper(KINDS["TipLoad"](a), 0.2)
    after = together(replace(together.rest(), t=t))
    assert (
        together.iterations.max() > 12 and together.iterations.min() < 6 and not after.status.any()
    )
    for k in (0, 1, 18, 69):
        alone = tb.Stepper(KINDS["TipLoad"](a[k]), 0.2)
        assert_close(
            after.position[k], alone(replace(alone.rest(), t=t[k])).position, rtol=1e-8, atol=1e-9
        )


def test_functions_that_cannot_be_mapped():
    """Python's branches and math on t: asked for one time after the other, with the same answer."""
    t = torch.tensor([0.1, 0.5, 0.9])
    plain, seen = [], []

    def jump(now):
        seen.append(now.ndim)
        return (0.0, 0.0, 0.3) if now < 0.4 else torch.tensor([0.0, math.sin(now), 0.0])

    for times in (t, *t):
        stepper = tb.Stepper(scene(tb.TipLoad(force=jump)), 0.03)
        plain.append(reading(stepper(replace(stepper.rest(times.shape), t=times))))
    assert_close(plain[0], torch.stack(plain[1:]), rtol=1e-12, atol=1e-13)
    assert set(seen) == {0}


def test_many_samples_with_many_times():
    """More times than are asked for at once, of a function with a value for each sample."""
    a, t = torch.linspace(-1, 1, 300), torch.linspace(0, 3, 300)
    found = at_time(lambda now: (a * torch.sin(now))[:, None].expand(300, 3000), t)
    assert_close(found[:, 0], a * torch.sin(t), rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    "value, sentence",
    [
        (None, "None"),
        (1j, "real numbers|1j"),
        ((0, 0, 1j), "real numbers"),
        ("abc", "abc"),
        (torch.ones(3) * 1j, "complex"),
        ((0.0, 1.0), r"\(..., 3\) is wanted"),
        ([[1.0], [1.0, 2.0]], "real numbers"),
        (torch.ones(2), r"\(..., 3\) is wanted"),
    ],
)
@pytest.mark.parametrize(
    "kind", ["load", "frame", "support", "actuation", "along", "elements", "flow", "user", "input"]
)
def test_what_is_no_number_is_refused(kind, value, sentence):
    made, inputs = {
        "load": lambda f: (scene(tb.TipLoad(force=f)), {}),
        "frame": lambda f: (scene(frame=tb.Frame(velocity=f)), {}),
        "support": lambda f: (scene(root=tb.RootMotion(f)), {}),
        "actuation": lambda f: (scene(tb.Actuation(f)), {}),
        "along": lambda f: (scene(tb.LineLoad(force=tb.Along(lambda s, t: f(t)))), {}),
        "elements": lambda f: (scene(tb.LineLoad(force=tb.PerElement(f))), {}),
        "flow": lambda f: (scene(tb.Drag(1.0, 1.0, flow=lambda r, t: f(t))), {}),
        "user": lambda f: (
            scene(tb.Load(lambda r, R, v, w, t: (f(t), torch.zeros(3)), node=-1, of=())),
            {},
        ),
        "input": lambda f: (scene(tb.TipLoad(force=tb.Input("u", 3))), {"u": f}),
    }[kind](lambda t: value)
    if kind == "user" and value is None:
        return  # absent
    with pytest.raises(
        ValueError,
        match="PerElement of shape" if kind == "elements" and "wanted" in sentence else sentence,
    ):
        tb.simulate(made, [0, 0.01], inputs=inputs)


FAST = [1e3, 5e3]  # Hz


@pytest.mark.parametrize("frequency", FAST)
def test_a_root_shaken_fast_starts_with_its_velocity(frequency):
    """u = a sin(wt + 1) and the same rotation about one axis: the rates at t = 0 are a w cos(1), to
    rounding; likewise those at the end of a step, and what the explicit form takes.
    """
    w, a, unit = 2 * math.pi * frequency, 1e-4, torch.tensor([0.0, 0.6, 0.8])
    motion = tb.RootMotion(
        lambda t: a * unit * torch.sin(w * t + 1), lambda t: a * unit * torch.sin(w * t + 1)
    )
    made = scene(root=motion)
    dt = 0.1 / frequency
    sol = tb.simulate(made, [0, dt], step=dt)
    for state, t in (
        (sol.state[0], 0.0),
        (sol.state[1], dt),
        (tb.simulate(made, [0, 1e-6], method="rk4").state[0], 0.0),
    ):
        want = a * w * math.cos(w * t + 1) * unit
        assert_close(state.node(0).velocity, want, rtol=1e-12, atol=1e-12)
        assert_close(state.node(0).spin, want, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("frequency", FAST)
def test_acceleration_of_a_root_shaken_fast(frequency):
    """-a w^2 sin(wt + 1), in a frame that turns with omega also 2 omega x v + omega x
    (omega x r).
    """
    w, a, unit = 2 * math.pi * frequency, 1e-4, torch.tensor([0.0, 0.6, 0.8])
    omega, t = torch.tensor([0.0, 0.0, 2.0]), torch.tensor([0.3, 0.1])
    made = scene(
        root=tb.RootMotion(lambda t: a * unit * torch.sin(w * t + 1)),
        frame=tb.Frame(angular_velocity=omega),
    )
    state = tb.rest(made, (2,), t)
    found = tb.sensors.NodeAcceleration(0, made)(state)
    u, v, acceleration = (
        x[:, None] * unit
        for x in (
            a * torch.sin(w * t + 1),
            a * w * torch.cos(w * t + 1),
            -a * w**2 * torch.sin(w * t + 1),
        )
    )
    cross = torch.linalg.cross
    omega = omega.expand(2, 3)
    assert_close(
        found,
        acceleration + 2 * cross(omega, v) + cross(omega, cross(omega, u)),
        rtol=1e-11,
        atol=1e-9,
    )


def test_spin_of_a_rotation_vector():
    """2 q' q* of its quaternion, small and large angles, with its derivatives."""
    for size in (0.0, 1e-9, 1e-3, 0.00999, 0.0101, 1.0, 3.0, 6.0):
        phi, rate = size * torch.tensor([0.36, 0.48, 0.8]), torch.tensor([0.3, -0.2, 0.7])
        q, q_dot = torch.func.jvp(quat.exponential, (phi,), (rate,))
        want = 2 * quat.multiply(q_dot, quat.conjugate(q))[1:]
        assert_close(quat.spin_of_vector(phi, rate), want, rtol=1e-11, atol=1e-12)
        assert torch.autograd.gradcheck(
            quat.spin_of_vector, (phi.requires_grad_(), rate.requires_grad_())
        )


@pytest.mark.parametrize(
    "function",
    [
        lambda t: (0.0, 0.0, 0.1 * math.sin(9 * t)),
        lambda t: (0.1, 0.0, 0.1 * math.cos(9 * t)),
        lambda t: torch.tensor([0.0, 0.0, torch.sin(t)]),
        lambda t: torch.as_tensor(t.numpy() * torch.ones(3).numpy()),
    ],
)
@pytest.mark.parametrize("name", ["displacement", "rotation"])
def test_a_motion_without_a_rate_is_refused(function, name):
    """math and NumPy leave torch: forward mode would see a root at rest."""
    with pytest.raises(ValueError, match="no rate in torch"):
        tb.simulate(scene(root=tb.RootMotion(**{name: function})), [0, 0.1], step=0.1)


@pytest.mark.parametrize(
    "function",
    [
        lambda t: torch.zeros(3),
        lambda t: (0.1, 0.0, 0.0 * t),
        lambda t: torch.tensor([0.1, 0, 0]) * torch.cos(9 * t),
        lambda t: torch.zeros(3) if t < 1 else torch.sin(t - 1) * torch.ones(3),
        lambda t: (0.0, 0.0, 10 * t**3),
        lambda t: (t - torch.sin(2e4 * t) / 2e4, 0.0, 0.0),
        lambda t: (0.0, 0.0, 20 * (t - 10 / math.pi * torch.sin(math.pi * t / 10))),
    ],
)
def test_a_motion_at_rest_is_taken(function):
    """A rate of zero at an instant is one, also where the motion sets out from there as t^3, or
    lost in rounding.
    """
    assert not tb.simulate(
        scene(root=tb.RootMotion(displacement=function)), [0, 0.05], step=0.05
    ).status.any()


def test_single_precision():
    """Rates and values keep the beam's dtype: forward mode by itself makes float64 of a float32
    scalar times a number.
    """
    beam = tb.Beam.straight(1.0, 2, SECTION)
    for t in (torch.tensor(0.2), torch.tensor([0.2, 0.3])):
        made = tb.Scene(
            beam,
            [tb.TipLoad(force=lambda t: (0.0, 0.1, 0.1 * torch.sin(t)))],
            root=tb.RootMotion(*(lambda t: (0.0, 0.0, 0.1 * torch.sin(9 * t)),) * 2),
            dtype=torch.float32,
        )
        state = tb.rest(made, t.shape, t.float())
        state = tb.Stepper(made, 0.01)(state)
        assert {x.dtype for x in vars(state).values() if isinstance(x, torch.Tensor)} == {
            torch.float32,
            torch.long,
        }
        assert not state.status.any()


def test_rates_under_every_derivative():
    """Of the first velocity a w cos(w t): backward, forward inside torch.func and of dual numbers,
    mapped, by a and by t.
    """

    def speed(a, t):
        made = tb.Scene(
            beam(), root=tb.RootMotion(rotation=lambda t: (0.0, 0.0, a * torch.sin(9 * t)))
        )
        return tb.rest(made, (), t).node(0).spin[2]

    t, one = torch.tensor(0.2), torch.tensor(1.0)
    by_a, by_t = 9 * torch.cos(9 * t), -81 * A * torch.sin(9 * t)
    assert_close(torch.func.grad(speed)(A, t), by_a)
    assert_close(torch.func.jvp(speed, (A, t), (one, 0 * one))[1], by_a)
    assert_close(torch.func.jvp(speed, (A, t), (0 * one, one))[1], by_t)
    assert_close(
        torch.func.vmap(speed)(torch.stack((A, 2 * A)), torch.stack((t, t))),
        torch.stack((A, 2 * A)) * by_a,
    )
    assert torch.autograd.gradcheck(
        speed, (A.clone().requires_grad_(), t.clone().requires_grad_()), check_forward_ad=True
    )


# fmt: off
NAMED = {
    "Load on the tip jumps as the beam moves": lambda: scene(
        tb.Load(lambda r, R, v, w, t: (-0.2 * v.sign(), None), node=-1, of="velocity")),
    "TipLoad on the tip is infinite or not a number": lambda:
    scene(tb.TipLoad(moment=lambda t: (0.0, 0.0, 1 / (t < 0.05)))),
    "LineLoad is infinite": lambda: scene(tb.LineLoad(force=lambda t: (0.0, 0.0,
                                                                       (0.05 - t).sqrt()))),
    "the frame's velocity is infinite": lambda: scene(frame=tb.Frame(velocity=lambda t: (0.0, 0.0,
        (0.05 - t).sqrt()))),
    "Actuation is infinite": lambda: scene(tb.Actuation(curvature=lambda t: (0.0, 0.0,
                                                                             (0.05 - t).sqrt()))),
    "the motion of the support of node 0 jumps in time": lambda: scene(
        root=tb.RootMotion(rotation=lambda t: torch.tensor([0.0, 0.0, 2.0]) * (t > 0.05))),
}
# fmt: on


@pytest.mark.parametrize(
    "method, sentence",
    told(
        [(method, sentence) for method in ("midpoint", "generalized_alpha") for sentence in NAMED],
        *(("midpoint", sentence) for sentence in NAMED),
        ("generalized_alpha", "Actuation is infinite"),
    ),
)
def test_what_no_smaller_step_helps_is_named(sentence, method):
    """In the reason, the warning and the error; the motion up to there is kept."""
    made = NAMED[sentence]()
    if method == "generalized_alpha" and made.frame is not None:
        return
    options = dict(step=0.03, method=method, halvings=3)
    with pytest.warns(RuntimeWarning, match=sentence):
        sol = tb.simulate(made, [0, 0.03, 0.09], **options)
    assert (
        sol.status != 0
        and sentence in sol.stats.reason[int(sol.status)]
        and "smaller step may help" not in str(sol.stats)
    )
    with pytest.raises(RuntimeError, match=sentence):
        tb.simulate(made, [0, 0.03, 0.09], throw=True, **options)


def test_only_the_failed_sample_counts():
    """A jump in a sample that goes well is not blamed: one that turns too far in each step for
    another reason says so.
    """
    jump = tb.Load(
        lambda r, R, v, w, t: (torch.tensor([[1e-9], [0.0]]) * -v.sign(), None),
        node=-1,
        of="velocity",
    )
    made = tb.Scene(beam(), [jump, tb.TipLoad(moment=torch.tensor([[0.0, 0, 0], [0, 0, 1e5]]))])
    with pytest.warns(
        RuntimeWarning, match="Newton's method did not converge; a smaller step may help"
    ):
        sol = tb.simulate(made, [0, 0.03], step=0.03, halvings=1)
    assert sol.status[1] == 1


def test_rates_of_several_values_within_dual_numbers():
    """Their tangents are the second derivatives, by reverse mode twice."""
    with forward_ad.dual_level():
        t = forward_ad.make_dual(torch.tensor(0.3), torch.tensor(1.0))
        _, rates = rate_along(lambda t: (t.sin(), t**3), (t,), (torch.ones(()),))
        (cosine, slope), (square, linear) = map(forward_ad.unpack_dual, rates)
    found = torch.stack((cosine, slope, square, linear))
    want = torch.tensor([math.cos(0.3), -math.sin(0.3), 3 * 0.3**2, 6 * 0.3])
    assert_close(found, want, rtol=1e-14, atol=0)
