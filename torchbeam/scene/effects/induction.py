"""Wind that a rotor induces."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.leaves import leaf
from ...core.validation import Value, as_tensor, common_dtype, increasing, refusal
from ...math.hat_functions import hats
from ...math.quaternions import cross
from .drag import norm
from .wind import WindField, along, direction


@dataclass(frozen=True, eq=False)
class Induction(WindField):
    """Wind that a rotor induces in its plane, by the radius about its axis through the origin.

        V = -axial(r) axis - swirl(r) axis x e_r

    Args:
        r: (n,) m, strictly increasing
        axial, swirl: (..., n) m/s, linear in r, constant beyond
        axis: (..., 3) along the wind, of any length; the rotor turns about it, right-handed

    Add it to the wind that comes: `StripAir(..., wind=tb.Wind((0, 0, 10)) + rotor.induction)`. The
    air that the rotor meets in its plane turns against it by `swirl`. It is that of a steady rotor:
    it does not change with the blades' motion.

    Examples:
        >>> slowed = tb.Induction((0.0, 50.0), (3.0, 3.0), (0.5, 0.0), axis=(0, 0, 1.0))
        >>> slowed.velocity(torch.tensor([[25.0, 0, 0]]), torch.tensor(0.0))
        tensor([[ 0.0000, -0.2500, -3.0000]])
    """

    r: Tensor = leaf(1)
    axial: Tensor = leaf(1)
    swirl: Tensor = leaf(1)
    axis: Value = leaf(1, default=(1.0, 0.0, 0.0), kw_only=True, check=direction)

    def __post_init__(self) -> None:
        super().__post_init__()
        dtype, device = common_dtype(self.r, self.axial, self.swirl)
        r = increasing("an Induction's r", as_tensor(self.r, dtype, device))
        both = {name: as_tensor(getattr(self, name), dtype, device) for name in ("axial", "swirl")}
        for name, value in both.items():
            if value.shape[-1:] != r.shape:
                raise refusal(
                    f"an Induction's {name} of shape {tuple(value.shape)}", f"(..., {len(r)})"
                )
        vars(self).update(r=r, **both)

    def velocity(self, position: Tensor, t: Tensor) -> Tensor:
        axis = self.axis[..., None, :]
        out = position - along(self.axis, position)[..., None] * axis
        r = norm(out)
        e = out / torch.where(r > 0, r, torch.ones_like(r))
        shares = hats(r[..., 0], self.r)
        slow, turn = ((shares * x[..., None, :]).sum(-1) for x in (self.axial, self.swirl))
        return -slow[..., None] * axis - turn[..., None] * cross(axis, e)
