"""Every number that a user can give, at 0 with a gradient: the derivative is that of the value's
differences. Whether a scene has something is decided from what was given, never from whether it is
0.

All cases in every way:  python -m pytest tests/properties/test_zero.py -m long
"""

import dataclasses
import inspect

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.zero_cases import CASES, NEVER_ZERO, N, scene, section
from tests.cases.zero_solutions import differences, forward, reverse, solved, value_and_slope
from torchbeam.extend import Tree, leaf

# of the largest derivative: of differences whose steps are 1e-3 of the numbers' size, of solutions
# to 1e-12
NOISE = 1e-6
SHORT = [(name, case.ways.split()[0]) for name, case in CASES.items()]
SHORT += [("Section.rotated and shifted", way) for way in ("eager", "modes", "linearize", "native")]
WHOLE = [(name, way) for name, case in CASES.items() for way in case.ways.split()]


def check(name: str, way: str, both_modes: bool) -> None:
    case = CASES[name]
    answer, n = solved(case, way), case.n
    y, J = differences(answer, n, case.scale, case.least)
    size = torch.maximum(J.abs().amax(), 1e-3 * y.abs().amax())
    w, v = torch.cos(torch.arange(len(y)).to(y)), torch.linspace(0.6, 1, n)
    alone, slope = value_and_slope(answer, n, w)
    # alone as beside samples that are not 0
    assert_close(alone, y, rtol=1e-9, atol=1e-12)
    assert_close(slope, w @ J, rtol=0, atol=NOISE * size * len(y) ** 0.5)
    if both_modes and way != "native":
        assert_close(forward(answer, v), J @ v, rtol=0, atol=NOISE * size)
    if both_modes and way not in ("native", "modes"):  # modes have no torch.func.vmap
        assert_close(torch.func.jacfwd(answer)(torch.zeros(n)), J, rtol=0, atol=NOISE * size)


@pytest.mark.parametrize(("name", "way"), SHORT)
def test_gradient_at_zero(name, way):
    """In one way to solve each case, some in more: reverse mode = differences."""
    check(name, way, both_modes=False)


@pytest.mark.long
@pytest.mark.parametrize(("name", "way"), WHOLE)
def test_gradient_at_zero_in_every_way(name, way):
    """Equilibria, both engines' motions, frequencies and transfer functions: reverse and both
    forward modes = differences.
    """
    check(name, way, both_modes=True)


DECLARED = leaf(0).metadata.keys()  # what fields have that hold tensors


def numbers():
    """Names of all that takes numbers: leaves of public effects, supports, motions and states,
    arguments of constructors.
    """
    for name in tb.__all__:
        made = getattr(tb, name)
        public = (
            inspect.isclass(made)
            and issubclass(made, Tree)
            and made.__module__.startswith(("torchbeam.scene", "torchbeam.state.state"))
        )
        if public and made not in (tb.Scene, tb.Beam):
            yield from (
                f"{name}.{f.name}"
                for f in dataclasses.fields(made)
                if f.init and DECLARED <= f.metadata.keys()
            )
    for made in (tb.Section, tb.Beam):
        for name, method in inspect.getmembers(made, callable):
            if (
                not name.startswith("_")
                and "return" in getattr(method, "__annotations__", {})
                and (method.__annotations__["return"] == made.__name__)
            ):
                for argument, of in inspect.signature(method).parameters.items():
                    if argument != "self" and of.annotation not in ("int", "bool", "Sections"):
                        yield f"{made.__name__}.{name} {argument}"


def test_every_number_has_a_case():
    """A new effect, support, section constructor or argument takes a row in the table of cases, or
    says why it is never 0.
    """
    known = list(CASES) + list(NEVER_ZERO)
    wanted = list(numbers())
    assert len(wanted) > 70
    assert [
        name
        for name in wanted
        if not any(k == name or k.startswith((f"{name} ", f"{name},")) for k in known)
    ] == []


@pytest.mark.parametrize(
    "method",
    [
        pytest.param("midpoint", marks=pytest.mark.long),  # test_gradient_at_zero, midpoint4
        "midpoint4",
        "generalized_alpha",
        "rk4",
        "minimal",
        "block_rate",
    ],
)
def test_methods(method):
    """Each method of motion with several numbers at 0: the end of two steps by coupling, damping,
    drag, load and mass.
    """
    implicit = method in ("midpoint", "midpoint4", "generalized_alpha")
    options = (
        dict(method=method, step=0.01, tolerance=1e-12)
        if implicit
        else dict(method="rk4", options={"step_size": 5e-4})
    )
    options = options | ({"form": method} if method in ("minimal", "block_rate") else {})

    def end(x):
        of = section().rotated(x[..., 0])
        effects = [
            tb.TipLoad(force=(0.2, 0.3, 0.4)),
            tb.TipLoad(moment=x[..., 1:2] * torch.ones(3)),
        ]
        effects += (
            [tb.MassDamping(x[..., 2])]
            if method in ("midpoint", "midpoint4", "generalized_alpha", "rk4")
            else []
        )
        made = tb.Scene(tb.Beam.straight(0.6, N, of), effects)
        solution = tb.simulate(
            made, torch.tensor([0.0, 0.002] if not implicit else [0.0, 0.02]), **options
        )
        state = solution.state[-1]
        return torch.cat((10 * state.tip.position, state.velocity[..., -1, :]), -1)

    J = differences(end, 3, 1e-3, True)[1]
    assert_close(reverse(end, 3, *torch.eye(6)), J, rtol=0, atol=NOISE * J.abs().amax().item())
    assert (J.abs().amax(0) > 0).sum() >= 2


def test_structure_is_declared():
    """Plain zeros are absent, at no cost; what came as a tensor is there, and what a constructor
    leaves out is not.
    """

    def has(of):
        return of.coupled, of.offset, of.rotary

    zero = torch.zeros(())
    plain = tb.Section.from_stiffness(EA=1.0, GA=1.0, GJ=1.0, EI=1.0, mass=1.0)
    assert has(plain) == (False, False, False)
    assert has(tb.Section(plain.compliance.tolist(), plain.mass.tolist())) == (False, False, False)
    assert has(tb.Section(plain.compliance, plain.mass)) == (True, True, True)
    assert has(section(EI=torch.tensor(1.0), inertia=0.0)) == (False, False, False)
    assert has(section(inertia=zero)) == has(section(inertia=(0.0, zero))) == (False, False, True)
    assert (
        has(plain.rotated(0.0))
        == has(plain.shifted(0.0))
        == has(plain.like(plain.compliance, plain.mass))
        == has(plain)
    )
    assert has(plain.rotated(zero)) == has(plain.rotated(0.3)) == (True, False, False)
    assert has(plain.shifted(y=zero)) == has(plain.shifted(z=0.1)) == (True, True, True)
    mixed = tb.Stations((0.0, 1.0), [plain, plain.rotated(zero)])
    assert has(mixed.section) == has(tb.Beam.straight(1.0, 2, mixed)) == (True, False, False)


def test_generalized_alpha_takes_a_centre_on_the_axis():
    """A constant mass matrix of a tensor is taken where its centre is on the axis, as
    `from_stiffness`; not where it is off it, or a gradient asks what moving it would do.
    """
    of, t = section(), torch.tensor([0.0, 0.02])

    def end(of):
        return tb.simulate(
            scene(of=of), t, method="generalized_alpha", step=0.02, tolerance=1e-12
        ).tip.position[-1]

    assert_close(end(tb.Section(of.compliance, of.mass)), end(of), rtol=0, atol=1e-12)
    for mass in (of.shifted(y=0.01).mass, of.mass.clone().requires_grad_()):
        with pytest.raises(ValueError, match="a mass off its node was given to generalized_alpha"):
            end(tb.Section(of.compliance, mass))


@pytest.mark.parametrize(("what", "rotary"), [("tau", 0.0), ("inertia", None)])
def test_linear_model_without_rotary_inertia(what, rotary):
    """Turns without inertia are condensed out of a linear model; its slow eigenvalues know what a
    first damping, or a first rotary inertia, does to them: as `modes`, which condenses nothing.
    """

    def of(x):
        return scene(
            *([tb.Damping(x)] if what == "tau" else []),
            of=section(inertia=rotary if rotary is not None else x),
        )

    def slow(x):
        value = torch.linalg.eigvals(tb.linearize(of(x)).A)
        value = value[value.imag > 0]
        return value[value.imag.argsort()[:3]]

    part = "real" if what == "tau" else "imag"
    x, y = (torch.zeros((), requires_grad=True) for _ in range(2))
    for k in range(3):
        (mine,) = torch.autograd.grad(getattr(slow(x)[k], part), x)
        (whole,) = torch.autograd.grad(getattr(tb.modes(of(y), count=3).eigenvalue[k], part), y)
        assert_close(mine, whole, rtol=1e-6, atol=0)
        assert mine < -1e-3


@pytest.mark.parametrize("derivatives", ["forward", "adjoint"])
def test_identify_from_zero(derivatives):
    """An angle of 0.2 rad is found from a start at 0, by derivatives of the model."""

    def model(p):
        return tb.equilibrium(scene(of=section(EI=(1.0, 3.0)).rotated(p["angle"]))).tip.position

    data = model({"angle": torch.tensor(0.2)})
    fit = tb.identify(
        model, tb.Measurement(data, sigma=1e-4), {"angle": 0.0}, derivatives=derivatives
    )
    assert abs(fit["angle"].item() - 0.2) < 1e-4


def test_plain_numbers_within_torch_func():
    """A pair of plain numbers is taken within torch.func too, where torch has no data of any tensor
    to show.
    """

    def tip(x):
        return tb.equilibrium(
            scene(tb.RootSpring((50.0, (8.0, 7.0, 6.0))), tb.TipLoad(force=x), supports=())
        ).tip.position

    assert_close(
        torch.func.jacfwd(tip)(torch.zeros(3)),
        differences(tip, 3, 1e-3, False)[1],
        rtol=1e-6,
        atol=1e-9,
    )


def test_plane_refuses_by_value():
    """In a plane an angle of 0 is one in it, also with a gradient, which is 0 there: what turns a
    section out of a plane is no part of a plane model. Another angle is refused.
    """
    angle = torch.zeros((), requires_grad=True)
    flat = tb.Scene(
        tb.Beam.straight(0.6, N, section().rotated(angle)),
        [tb.TipLoad(force=(0.0, 0, 0.4))],
        plane="xz",
    )
    tip = tb.equilibrium(flat).tip.position
    assert torch.autograd.grad(tip[2], angle)[0] == 0
    with pytest.raises(ValueError, match=r"(mass|compliance) couples the plane 'xz'"):
        tb.equilibrium(
            tb.Scene(tb.Beam.straight(0.6, N, section().rotated(angle + 0.1)), plane="xz")
        )
