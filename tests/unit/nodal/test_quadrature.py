"""Weights of the nodes: Gregory's rule on equal and on unequal elements."""

import torch
from torch.testing import assert_close

from tests.cases.nodal_cases import orders
from torchbeam.nodal.mass import gregory, trapezoidal


def test_equal_elements_have_the_textbook_weights():
    """One element half and half, two Simpson's rule, three the 3/8 rule, six Gregory's; to
    rounding.
    """
    for N, want in (
        (1, [0.5, 0.5]),
        (2, [1 / 3, 4 / 3, 1 / 3]),
        (3, [3 / 8, 9 / 8, 9 / 8, 3 / 8]),
        (6, [3 / 8, 7 / 6, 23 / 24, 1, 23 / 24, 7 / 6, 3 / 8]),
    ):
        assert_close(gregory(torch.full((N,), 0.2)), 0.2 * torch.tensor(want), rtol=1e-14, atol=0)


def test_quadratics_are_exact_on_unequal_elements():
    """The slopes of a parabola are those of the parabola: to rounding, in a batch, lengths 1 to
    1.4.
    """
    torch.manual_seed(0)
    h = 1 + 0.4 * torch.rand(3, 7)
    s = torch.nn.functional.pad(h.cumsum(-1), (1, 0))
    found = torch.stack([(gregory(h) * s**k).sum(-1) for k in range(3)], -1)
    assert_close(
        found,
        torch.stack([s[..., -1] ** (k + 1) / (k + 1) for k in range(3)], -1),
        rtol=1e-13,
        atol=0,
    )


def test_fourth_order_on_a_graded_mesh():
    """Integral of exp(s), elements that grow evenly to three times the first: order 4, where the
    trapezoidal rule has 2.
    """
    errors = []
    for N in (16, 32, 64):
        s = (lambda x: (x + x**2) / 2)(torch.linspace(0, 1, N + 1))
        errors.append(
            torch.stack(
                [
                    (w(s.diff()) * s.exp()).sum() - (1.0 * torch.exp(torch.ones(())) - 1)
                    for w in (gregory, trapezoidal)
                ]
            )
        )
    assert_close(
        orders(torch.stack(errors).abs()), torch.tensor([[4.0, 2.0]] * 2), rtol=0, atol=0.2
    )


def test_density_by_element_and_what_falls_back():
    """Mass and its first moment are those of the trapezoidal rule whatever the density; a jump by
    30 leaves that rule itself, for that sample alone.
    """
    h, rho = torch.full((2, 5), 0.2), torch.tensor([[1, 1.2, 1.4, 1.6, 1.8], [1, 1, 30, 30, 30]])
    s = torch.linspace(0, 1, 6)
    one, plain = gregory(h, rho), trapezoidal(h, rho)
    assert_close(
        (one * torch.stack((s**0, s))[:, None]).sum(-1),
        (plain * torch.stack((s**0, s))[:, None]).sum(-1),
    )
    assert torch.equal(one[1], plain[1]) and not torch.equal(one[0], plain[0])
