"""Designs: any part is the same wherever it begins; replicates, plain samples and own ones; a
folder is of one design.
"""

import math

import pytest
import torch
from torch.testing import assert_close

import torchbeam as tb
from tests.cases.refusals import refusals
from torchbeam.uncertainty.designs import Exchanged, Given, Plain, Sobol, sobol
from torchbeam.uncertainty.joint_law import JointLaw

JOINT = JointLaw.of({"a": (0.0, 1.0), "b": (0.0, 1.0), "c": (0.0, 1.0)})


def test_sobol_is_torchs_own():
    """To the bit, from any place: torch's engine walks there, ours jumps."""
    for first in (0, 1, 2, 1000, 65537):
        engine = torch.quasirandom.SobolEngine(5, scramble=True, seed=3).fast_forward(first)
        wanted = engine.draw(7, dtype=torch.float64)
        assert_close(
            sobol(5, 3, first, first + 7), wanted + 2.0**-31, rtol=0, atol=1e-7 if first == 0 else 0
        )
    assert sobol(2, 0, 2**30 - 5, 2**30).shape == (5, 2)


@pytest.mark.parametrize(
    "design",
    [
        Sobol(3, 1),
        Sobol(3, 1, 32),
        Plain(3, 1),
        Plain(9, 1),
        Exchanged(Sobol(6, 1, 8), torch.eye(3, dtype=torch.bool)),
        Given(torch.rand(100, 3, generator=torch.Generator().manual_seed(0))),
    ],
    ids=str,
)
def test_parts(design):
    """100 at once, or in parts of 7."""
    if isinstance(design, Plain) and design.dimension == 9:
        whole = design.uniform(0, 100)
        parts = [design.uniform(k, min(k + 7, 100)) for k in range(0, 100, 7)]
    else:
        whole = design.theta(JOINT, 0, 100)
        parts = [
            design.part(k, min(k + 7, 100)).theta(JOINT, k, min(k + 7, 100))
            for k in range(0, 100, 7)
        ]
    assert (torch.cat(parts) == whole).all() and whole.min() > 0 and whole.max() < 1


def test_replicates_are_nets():
    """Each sequence of 32 has one point in each 32nd of each axis, and no two are alike."""
    u = Sobol(3, 5, 32).uniform(0, 96).reshape(3, 32, 3)
    assert ((u * 32).floor().sort(1).values == torch.arange(32.0)[:, None]).all()
    assert (u[0] == Sobol(3, 5).uniform(0, 32)).all() and not (u[1] == u[0]).any()


def test_plain_is_independent():
    """Means and correlations of 2^16 as of independent uniform numbers, within five deviations;
    another seed, others.
    """
    u = Plain(3, 0).uniform(0, 2**16)
    assert_close(u.mean(0), torch.full((3,), 0.5), rtol=0, atol=5 / math.sqrt(12 * 2**16))
    both = torch.cat((u[:-1], u[1:]), 1)  # with the next
    off = torch.corrcoef(both.mT) - torch.eye(6)
    assert off.abs().max() < 5 / 2**8
    assert not (Plain(3, 1).uniform(0, 100) == u[:100]).any()


def test_exchanged():
    """Rows: A, B, A with the part of B, for each part."""
    design = Exchanged(Sobol(6, 0), torch.tensor([[True, True, False], [False, False, True]]))
    A, B, AB1, AB2 = design.theta(JOINT, 0, 4)
    wanted = Sobol(6, 0).uniform(0, 1)[0]
    assert_close(torch.cat((A, B)), wanted, rtol=0, atol=0)
    assert_close(AB1, torch.cat((B[:2], A[2:]))) and assert_close(AB2, torch.cat((A[:2], B[2:])))


def test_own_samples(tmp_path):
    """theta= in place of a design, in float32 if that is asked for; a folder knows it by its
    content.
    """
    theta = torch.rand(20, 2, generator=torch.Generator().manual_seed(1))
    found = tb.monte_carlo(torch.sin, ("a", "b"), theta=theta, chunk=7, out=tmp_path)
    assert (
        (found.theta == theta).all()
        and (found.y == theta.sin()).all()
        and found.independent
        and found.names == ("a", "b")
    )
    assert len(tb.monte_carlo(torch.sin, ("a", "b"), 9, theta=theta)) == 9
    assert (
        tb.monte_carlo(torch.sin, ("a", "b"), theta=theta.tolist(), dtype=torch.float32).y.dtype
        == torch.float32
    )
    with pytest.raises(ValueError, match="other samples was given"):
        tb.monte_carlo(
            torch.sin, ("a", "b"), theta=theta + 1e-15 * (theta > 0.9), chunk=7, out=tmp_path
        )


def test_a_folder_is_of_one_design(tmp_path):
    laws = {"a": (0.0, 1.0)}
    plain = tb.monte_carlo(torch.sin, laws, 32, design="plain", chunk=8, out=tmp_path / "plain")
    tb.monte_carlo(torch.sin, laws, 32, replicates=4, chunk=8, out=tmp_path / "replicates")
    # of as many points each
    longer = tb.monte_carlo(torch.sin, laws, 64, replicates=8, chunk=8, out=tmp_path / "replicates")
    assert longer.replicates == 8 and plain.independent and not longer.independent
    for folder, options, sentence in (
        ("plain", {}, "another design was given"),
        ("replicates", {}, "another size"),
        ("replicates", dict(replicates=2), r"another size was given \(8 there, 16 here"),
    ):
        with pytest.raises(ValueError, match=sentence):
            tb.monte_carlo(torch.sin, laws, 32, chunk=8, out=tmp_path / folder, **options)


# fmt: off
REFUSED = {
    "design": (dict(design="lattice"), "design = 'lattice' was given; 'sobol', 'plain' are there"),
    "replicates": (dict(n=100, replicates=16), "n = 100 was given for 16 replicates; a multiple"),
    "theta of another size": (dict(laws=("a", "b"), theta=torch.ones(4, 3)),
                              r"theta \(4, 3\) was given; \(n, 2\) is wanted"),
    "theta of NaN": (dict(laws=("a",), theta=[[math.nan]]), "theta"),
    "theta and replicates": (dict(laws=("a",), theta=torch.ones(4, 1), replicates=2, n=4),
                             "beside theta"),
    "theta and correlation": (dict(laws=("a",), theta=torch.ones(4, 1), correlation=torch.eye(1),
                                   n=4), "beside theta"),
    "more than there are": (dict(laws=("a",), theta=torch.ones(4, 1), n=5),
                            "n = 5 was given with 4 rows"),
    "one name": (dict(laws="ab", theta=torch.ones(4, 2)), "names, one for each column"),
    "names twice": (dict(laws=("a", "a"), theta=torch.ones(4, 2)), "names, one for each column"),
}
# fmt: on


@refusals(REFUSED)
def test_refused(changed):
    tb.monte_carlo(
        **{
            **dict(function=torch.sin, laws={"a": (0.0, 1.0)}, n=None if "theta" in changed else 8),
            **changed,
        }
    )
