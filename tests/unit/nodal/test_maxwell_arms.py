"""Arms that relax: one step of a strain that is linear in time, against its exact solution."""

import torch

from torchbeam.nodal.maxwell_arms import TERMS, MaxwellArms


def draw(seed=0, samples=4000):
    """Shares and times of two arms, strains at both ends of a step of 1 s, and what has crept: the
    step from 1e-4 to 1e4 of a time.
    """
    g = torch.Generator().manual_seed(seed)
    times = 10 ** (8 * torch.rand(samples, 1, 1, 2, generator=g) - 4)
    shares = 0.5 * torch.rand(samples, 1, 1, 2, generator=g)
    start, end = torch.randn(2, samples, 1, 1, generator=g)
    crept = torch.randn(samples, 1, 2, generator=g)
    return MaxwellArms(shares, times), start, end, crept, torch.ones(samples, 1, 1)


def test_a_step_is_that_of_the_differential_equation():
    """q' = (e - q)/tau along e = e_0 + de t/h, by 400 intervals of Simpson's rule in the variation
    of constants, where tau is not short beside an interval; the mean of e - q likewise.
    """
    arms, start, end, crept, h = draw()
    keep = (arms.times > 0.05).all(-1).flatten()
    arms = MaxwellArms(arms.shares[keep], arms.times[keep])
    start, end, crept, h = (x[keep] for x in (start, end, crept, h))
    t = torch.linspace(0, 1, 801)
    weights = torch.tensor([1.0] + [4.0, 2.0] * 399 + [4.0, 1.0]) / 2400
    e = start[..., None, None] + (end - start)[..., None, None] * t
    tau = arms.times[..., None]
    q = arms.each(crept)[..., None] * torch.exp(-1 / tau)
    q = q[..., 0] + (weights * e / tau * torch.exp(-(1 - t) / tau)).sum(-1)
    decay = arms.decay(h)
    after = arms.advanced(start, end - start, crept, decay)
    assert (arms.each(after) - q).abs().max() < 1e-7
    lag = arms.times * (arms.each(after) - arms.each(crept))  # the integral of tau q'
    mean = arms.remaining * (start + end) / 2 + (arms.shares * lag).sum(-1)
    of = decay.mean, decay.rising
    relaxed = arms.relaxed((start + end) / 2, start, end - start, crept, of)
    assert (mean - relaxed).abs().max() < 1e-12 * arms.times.max()


def test_no_step_gains_energy():
    """Work of the mean stress less what the energy rises by is not negative, whatever shares, times
    and steps are, and that of the exact solution: with a = d_0 - tau v and d = a exp(-t/tau) + tau
    v, tau v = tau de/h, the integral of d^2/tau.
    """
    arms, start, end, crept, h = draw()
    decay, change = arms.decay(h), end - start
    d0 = start[..., None] - arms.each(crept)
    d1 = end[..., None] - arms.each(arms.advanced(start, change, crept, decay))
    mean = decay.mean * d0 + decay.rising * change[..., None]
    work = mean * change[..., None]
    lost = work - (d1.square() - d0.square()) / 2
    z, v = 1 / arms.times, arms.times * change[..., None]
    a = d0 - v
    exact = a.square() / 2 * -torch.expm1(-2 * z) + 2 * a * v * -torch.expm1(-z) + v.square() * z
    size = work.abs() + d0.square() + d1.square()
    assert (lost > -1e-15 * size).all()
    resolved = z > 1e-2  # beyond it the sum above is a difference of large numbers
    assert ((lost - exact).abs() < 1e-11 * size)[resolved].all()


def test_both_forms_of_the_rising_weight_agree():
    """The series of psi and its closed form, where they meet, to rounding; as many terms as it
    takes, and no more: with two fewer it is off.
    """
    arms = MaxwellArms(torch.full((1, 1, 1), 0.5), torch.ones(1, 1, 1))
    below, above = (arms.decay(torch.full((1, 1), x)).rising for x in (0.5 - 1e-15, 0.5 + 1e-15))
    assert (below - above).abs() < 1e-15
    terms = torch.cumprod(0.5 / torch.arange(2.0, TERMS + 2), 0)
    assert terms[-1] < 1e-15 < terms[-3]


def test_the_end_is_far_beyond_its_times_what_a_damper_has():
    """After many times of an arm its stress is that of a damper, share tau de/dt, in the mean and
    at the end: nothing swings to and fro.
    """
    arms = MaxwellArms(torch.full((1, 1, 1), 0.5), torch.full((1, 1, 1), 1e-6))
    start, end, h = torch.zeros(1, 1), torch.ones(1, 1), torch.ones(1, 1)
    decay = arms.decay(h)
    for of in ((decay.kept, decay.mean), (decay.mean, decay.rising)):
        lag = of[1] * (end - start)[..., None]
        assert torch.allclose(lag, torch.tensor(1e-6), rtol=2e-6)
