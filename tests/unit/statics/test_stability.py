"""Equilibria that are unstable under loads that are not conservative: what a warning names."""

import re
import warnings

import pytest
import torch

import torchbeam as tb

ENGINES = "eager", "compiled"


def column(force, moment, frame=None, EI=(1.0, 4.0)):
    """Cantilever under dead loads (batch, 3) of its tip: the moment, in space, has no energy."""
    section = tb.Section.from_stiffness(EA=1e5, GA=1e5, GJ=0.8, EI=EI, mass=0.2, inertia=1e-3)
    return tb.Scene(
        tb.Beam.straight(1.0, 6, section), [tb.TipLoad(force=force, moment=moment)], frame=frame
    )


def told(scene, engine="eager"):
    """The equilibria, and the warning or None."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        state = tb.equilibrium(scene, engine=engine)
    said = [str(one.message) for one in heard if issubclass(one.category, RuntimeWarning)]
    assert len(said) < 2
    return state, said[0] if said else None


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("turning", [False, True], ids=["moment", "turning frame"])
@torch.no_grad()
def test_one_motion_that_diverges(engine, turning):
    """Buckling at pi^2/4 = 2.47 N in the soft plane, 9.9 N in the stiff one: one negative pivot in
    between, where the warning names the sample; past both the determinant is positive again, and
    nothing is said (`modes` knows).
    """
    if engine == "compiled":
        pytest.importorskip("llvmlite")
    P = torch.tensor([1.0, 2.3, 4.0, 8.0, 15.0])
    none = torch.zeros_like(P)
    moment = torch.stack((none if turning else 1e-6 + none, none, none), -1)
    frame = tb.Frame(angular_velocity=(0.0, 0.0, 0.01)) if turning else None
    scene = column(torch.stack((-P, none, none), -1), moment, frame)
    state, said = told(scene, engine)
    assert re.search(r"sample 2 \(2 of 5\) is in unstable equilibrium", said)
    assert tb.modes(scene, state, count=3).divergence.any(-1).tolist() == [
        False,
        False,
        True,
        True,
        True,
    ]


@torch.no_grad()
def test_who_is_named_diverges():
    """Bent columns under dead moments in space, named alone where an odd number of its modes
    diverge, nowhere else.
    """
    generator = torch.Generator().manual_seed(5)
    P, M = 6 * torch.rand(12, generator=generator), 0.6 * torch.randn(12, 3, generator=generator)
    force = torch.stack((-P, 0 * P, 0 * P), -1)
    bent = column(force, M)
    diverging = tb.modes(bent, told(bent)[0], count=4).divergence.sum(-1)
    named = [told(column(f, m))[1] is not None for f, m in zip(force, M, strict=True)]
    assert named == (diverging % 2 == 1).tolist() and 0 < sum(named) < 12
