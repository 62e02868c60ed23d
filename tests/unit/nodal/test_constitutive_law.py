"""What impossible strains store, and by what that may be differentiated."""

import math

import pytest
import torch

import torchbeam as tb

RIGID = torch.diag(torch.tensor([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))
MASS = torch.diag(torch.tensor([0.2, 0.2, 0.2, 1e-3, 1e-3, 1e-3]))


def pulled(section, force=(1.0, 0.1, 0.2), **options):
    """Two elements, one step."""
    scene = tb.Scene(tb.Beam.straight(1.0, 2, section), [tb.TipLoad(force=force)])
    return tb.simulate(scene, [0.0, 0.02], step=0.02, **options)


@pytest.mark.parametrize("options", [{}, {"conserve": True}], ids=str)
def test_no_energy_by_zeros_of_a_compliance(options):
    """The energy of a strain that is impossible is known at no instant; `conserve` scales by it."""
    S = RIGID.clone().requires_grad_()
    solution = pulled(tb.Section(S, MASS), **options)
    asked = solution.tip.velocity[-1].sum() if options else solution.energy.strain[-1]
    with pytest.raises(NotImplementedError, match=r"strain energy.*a zero on its diagonal"):
        asked.backward()
    assert S.grad is None


def test_no_energy_by_zeros_of_a_compliance_forward():
    def strain_energy(x):
        S = RIGID + torch.diag(torch.nn.functional.pad(x[None], (0, 5)))
        return pulled(tb.Section(S, MASS)).energy.strain[-1]

    with pytest.raises(NotImplementedError, match="a zero on its diagonal"):
        torch.func.jvp(strain_energy, (torch.zeros(()),), (torch.ones(()),))


def test_what_else_energy_depends_on():
    """By loads beside such a compliance, whose own gradient of places stays, and by a stiffness
    beside math.inf, as differences: central, of 1e-5, of smooth functions of size 1.
    """

    def matrix(k):
        force = k * torch.tensor([1.0, 0.1, 0.2])
        return pulled(tb.Section(RIGID.clone().requires_grad_(), MASS), force)

    def inextensible(k):
        return pulled(tb.Section.from_stiffness(math.inf, math.inf, 1.0, k, 0.2, 1e-3))

    for run in (matrix, inextensible):
        k = torch.tensor(1.0, requires_grad=True)
        (slope,) = torch.autograd.grad(run(k).energy.strain[-1], k)
        more, less = (run(torch.tensor(1 + e)).energy.strain[-1].detach() for e in (1e-5, -1e-5))
        torch.testing.assert_close(slope, (more - less) / 2e-5, rtol=1e-6, atol=0)
        assert slope != 0
    S = RIGID.clone().requires_grad_()
    pulled(tb.Section(S, MASS)).tip.position[-1].sum().backward()
    assert S.grad[0, 0] != 0


@pytest.mark.parametrize("engine", ["eager", "compiled"])
def test_six_times_of_damping_beside_impossible_strains(engine):
    """Those of impossible strains damp nothing; six alike are one; torsion has its own. A coupled
    section and linked elements are refused.
    """
    section = tb.Section.from_stiffness(math.inf, math.inf, 0.6, (0.5, 0.8), 0.3, 1e-4)
    beam = tb.Beam.straight(1.0, 2, section)

    def tip(tau):
        load = tb.TipLoad(force=(0, 0.3, 1.0), moment=(0.1, 0, 0))
        scene = tb.Scene(beam, [load, tb.Damping(tau)])
        return tb.simulate(scene, [0.0, 0.1], step=0.01, engine=engine).state[-1]

    one = tip(0.02)
    for impossible in ((0.02,) * 3, (0.0, 0.0, 0.0), (7.0, 0.0, 3.0)):
        six = tip((*impossible, 0.02, 0.02, 0.02))
        torch.testing.assert_close(six.position, one.position, rtol=0, atol=1e-9)
    twisted = tip((0.0, 0, 0, 0.2, 0.02, 0.02)).rotation - one.rotation
    assert twisted.abs().max() > 1e-4
    with pytest.raises(ValueError, match=r"six-valued tau.*linked"):
        tb.modes(tb.Scene(beam.linked(), [tb.Damping((0.1,) * 6)]))
