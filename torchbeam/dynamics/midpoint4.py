"""midpoint4: fourth order in time, of midpoint steps.

The midpoint step P(h) is symmetric, P(-h) P(h) = 1, so that its error has odd powers of h alone,
h^3, h^5, ... Steps in a row, of shares a_k of h whose sum is 1, have no h^3 where sum a_k^3 = 0;
being symmetric too they are then of fourth order:

    S(h) = P(p h) P(p h) P((1 - 4 p) h) P(p h) P(p h)        p = 1/(4 - 4^(1/3)) = 0.4145
    (Suzuki 1990)

The third goes back by 0.658 h. At equal cost its error is a ninth of that of three steps
(Yoshida 1990), in a linear oscillation.

Stability, on y' = lambda y, z = lambda h: the midpoint step multiplies by (1 + z/2)/(1 - z/2), of
modulus 1 for any oscillation, and so does S. But what decays grows in a step that goes back: S has
a pole at z = -3.04, and amplifies within 0.016 of it, and nowhere else; no real composition of an
order above two is without. Damping by tau has an eigenvalue there for some stiffness as soon as
tau > 0.329 h. Before it comes to that, where tau > h/6, extrapolation takes the place of S, sample
by sample, which has positive steps alone and the same order (Hairer, Lubich and Wanner 2006, II.4
and V.3, on both):

    E(h) = (9 P(h/3)^3 - P(h))/8

of all that a state has; rotations, unit quaternions, are made such again. E is stable for motion
that is damped by tau > 0.03 h (a third and a whole have the same sign at infinity, |E| = 1; with a
half it is 5/3), and not for undamped motion, which it would amplify by up to 1.25 in a step.
Neither is stable where tau has six values, some above h/6 and some below h/30, or where
`MassDamping` of alpha comes near the pole: refused, the latter from alpha h = 2.8 on. So are
springs beside a strongly damped beam (`Spring`, `RootSpring`) that have no damper of h/30 times
their stiffness, and with the mass of their node alone an angular frequency above 0.5/h: E would
amplify it. Where more than the node moves with the spring, it is slower, and refused as well: how
much does, is not known here. Other dampers (`Drag`, loads by velocity, lags) do not say how fast
they are: steps shorter than 3 times their fastest decay's 1/e time are on the safe side of the
pole; nor do springs of users' own loads. Arms of `Viscoelastic` that forget in less than a third of
a step are refused: stable up to steps of 6 times the shortest time, whatever frequency and share,
and not resolved by then.

Momentum: S keeps it exactly, with reaction and loads as means over the step, as P does; E linear
momentum exactly, angular momentum to fifth order a step. Energy: to fifth order a step; S, being
symmetric, lets it swing but not drift where motion is resolved. The stress is that of the last
solve, its mean over the last 0.41 (S) or third (E) of the step.

Strongly damped (E), velocities and reactions are of second order, positions and rotations of
fourth. The velocity of a node that a support leads by some of its components, or a joint holds, and
its reaction, are of second order, as by P.

Order is lost where the motion has no derivatives that the step resolves: in waves that a sudden
load excites and that are faster than the step (they stay bounded, with a wrong phase), at kinks of
a load or an input in time; and with internal states of loads whose rates are not linear, where a
linearly implicit solve is not symmetric: third order.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..core.arguments import boolean
from ..core.validation import concrete
from ..nodal.model import Model
from ..scene.effects import MassDamping, RootSpring, Spring, Viscoelastic
from .method import WHOLE, Composition, Method, Scheme, without_rho

P = 1 / (4 - 4 ** (1 / 3))
SYMMETRIC = Scheme((Composition((P, P, 1 - 4 * P, P, P)),))
EXTRAPOLATED = Scheme((WHOLE, Composition((1 / 3, 1 / 3, 1 / 3))), (-1 / 8, 9 / 8))
FAST = 1 / 6  # of h: tau from which on the extrapolation is taken
SLOW = 1 / 30  # of h: tau up to which it is not stable
HEAVY = 2.8  # alpha h that no scheme takes
FORGETFUL = 3.0  # h over the shortest relaxation time, likewise
# omega h up to which the extrapolation amplifies what is undamped by less than 1e-5 in a step
RESOLVED = 0.5


class Midpoint4(Method):
    """See above."""

    ORDER = 4
    SOLVES_A_STEP = 5

    @classmethod
    def of(cls, name: str, conserve: bool, rho_inf: float | None) -> Midpoint4:
        without_rho(name, rho_inf)
        if boolean("conserve", conserve):
            raise ValueError(
                "conserve was given; midpoint4 keeps the energy to fifth order a step "
                "('midpoint' takes it)"
            )
        return cls()

    def longest(self, model: Model) -> Tensor | None:
        longest = [
            HEAVY / concrete(load.alpha.detach())
            for load in model.scene.loads
            if isinstance(load, MassDamping)
        ]
        longest += [FORGETFUL * _shortest(effect) for effect in model.scene.viscoelastic]
        return torch.stack(torch.broadcast_tensors(*longest)).amin(0) if longest else None

    def check(self, model: Model) -> None:
        super().check(model)
        touching = (x for x in model.scene.loads if x.between_nodes or x.touches)
        lossy = [x.called for x in touching if not x.conservative or x.lossy or x.moves]
        lossy += [f"{x.called} with friction" for x in model.scene.joints if "friction" in x.acts]
        lossy += [f"{x.called} with hysteresis" for x in model.scene.joints if x.hysteresis]
        lossy += ["Tendon with friction"] * model.tendons.dissipative
        lossy += [f"{x.called} with friction or damping" for x in model.scene.pairs if x.lossy]
        if lossy:
            raise ValueError(
                f"{lossy[0]}, that takes or gives energy, was given to midpoint4, one of whose "
                "parts goes back in time; 'midpoint' takes it"
            )

    def schemes(self, model: Model, dt: Tensor) -> list[tuple[Scheme, Tensor | None]]:
        length = concrete(dt.detach())
        said = "was given to steps of {:g} s by midpoint4; {}, or 'midpoint'"
        for load in model.scene.loads:
            if isinstance(load, MassDamping):
                alpha = concrete(load.alpha.detach())
                if (alpha * length > HEAVY).any():
                    wanted = f"less than {HEAVY} a step is wanted"
                    raise ValueError(
                        f"MassDamping of {alpha.max():g} 1/s {said.format(length.max(), wanted)}"
                    )
        for effect in model.scene.viscoelastic:
            shortest = _shortest(effect)
            if (length > FORGETFUL * shortest).any():
                wanted = f"at least {1 / FORGETFUL:.2g} of a step is wanted"
                raise ValueError(
                    f"Viscoelastic with a time of {shortest.min():g} s "
                    f"{said.format(length.max(), wanted)}"
                )
        damping = model.scene.damping
        if damping is None:
            return [(SYMMETRIC, None)]
        taus = [concrete(effect.tau.detach()) for effect in model.scene.dampings]
        pairs = zip(model.scene.dampings, taus, strict=True)
        taus = [
            part for effect, tau in pairs for part in (tau.unbind(-1) if effect.six else (tau,))
        ]
        if damping.on is not None and len(model.scene.dampings) < len(model.scene.beam.beams):
            taus.append(torch.zeros_like(taus[0]))  # of beams without
        taus = torch.stack(torch.broadcast_tensors(*taus))
        most, least = taus.amax(0), taus.amin(0)
        fast = most > FAST * length
        if not fast.any():
            return [(SYMMETRIC, None)]
        if (fast & (least < SLOW * length)).any():
            wanted = "values that are all above 1/30 of a step, or all below 1/6, are wanted"
            raise ValueError(
                f"tau from {least.min():g} to {most.max():g} s {said.format(length.max(), wanted)}"
            )
        for load in model.scene.loads:
            if isinstance(load, (Spring, RootSpring)):
                bare = _undamped(load, model, length) & fast
                if bare.any():
                    h = length.max()
                    wanted = (
                        f"damping= of at least {SLOW * h:.2g} s times its stiffness is wanted, "
                        f"Damping below {FAST * h:.2g} s"
                    )
                    raise ValueError(f"an undamped {type(load).__name__} {said.format(h, wanted)}")
        return [(EXTRAPOLATED, None)] if fast.all() else [(SYMMETRIC, ~fast), (EXTRAPOLATED, fast)]


def _shortest(effect: Viscoelastic) -> Tensor:
    """(...) s: its shortest relaxation time."""
    times = concrete(effect.times.detach())
    return times.flatten(-2).amin(-1) if effect.six else times.amin(-1)


def _undamped(spring: Spring | RootSpring, model: Model, h: Tensor) -> Tensor:
    """Whether samples (...) have a spring that is faster than steps h (...) resolve, by the mass of
    its node, and undamped.
    """
    k = concrete(spring.stiffness.detach())
    c = torch.zeros_like(k) if spring.damping is None else concrete(spring.damping.detach())
    per_length = model.section_mass[..., spring.node, :, :].diagonal(dim1=-2, dim2=-1)
    damping = concrete((per_length * model.tributary_length[..., spring.node, :]).detach())
    if isinstance(spring, Spring):
        return (k * h**2 > RESOLVED**2 * damping[..., 0]) & (c < SLOW * h * k)
    h = h[..., None]
    moving = torch.tensor([True] * 3 + [model.inertia.rotary.present] * 3, device=damping.device)
    return ((k * h**2 > RESOLVED**2 * damping) & (c < SLOW * h * k) & moving).any(-1)
