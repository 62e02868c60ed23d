"""Plant: the beam that episodes are about, as a function of parameters that may change from one to the next."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torchbeam import Beam, Damping, ExplicitStepper, Gravity, Scene, Section, Stepper
from torchbeam.integrate.stepper import METHODS as IMPLICIT_METHODS

HALVINGS = 2  # a failed step is made again in 2 and 4 parts; more would cost the whole batch more than the episode is worth


@dataclass(frozen=True)
class Parameter:
    """A number that may change with the episode.

    value      what it is unless it varies
    low, high  the range that randomize=True draws from
    least      smallest value; `above`: which it must exceed
    """

    value: float
    low: float
    high: float
    least: float = 0.0
    above: bool = False

    def check(self, name: str, value: Any) -> None:
        """ValueError where one of the values is out of bounds, infinite or NaN."""
        low = np.asarray(value)
        if not (np.isfinite(low) & ((low > self.least) if self.above else (low >= self.least))).all():
            wanted = f"a finite number {'above' if self.above else 'of at least'} {self.least:g}"
            raise ValueError(f"{name} = {low.tolist()} was given; {wanted} is wanted")


class Parameters(dict[str, Parameter]):
    """What may change with the episode, by name; ValueError where a name or a value is not among it."""

    def named(self, name: str) -> Parameter:
        if name not in self:
            wanted = f"there are {', '.join(self)}" if self else "this form of the beam has none"
            raise ValueError(f"the parameter {name!r} was given; {wanted}")
        return self[name]

    def ranges(self, randomize: bool | dict[str, Sequence[float]] | None) -> dict[str, tuple[float, float]]:
        """name -> (low, high) of what is drawn at each reset, in the order of the names here."""
        if randomize is True:
            if not self:
                raise ValueError("randomize was given; this form of the beam has no parameters to vary")
            return {name: (p.low, p.high) for name, p in self.items()}
        randomize = randomize or {}
        for name, bounds in randomize.items():
            self.named(name).check(name, bounds)
            if np.shape(bounds) != (2,) or bounds[0] > bounds[1]:
                raise ValueError(f"randomize = {{{name!r}: {bounds!r}}} was given; (low, high) is wanted")
        return {name: tuple(map(float, randomize[name])) for name in self if name in randomize}

    def given(self, name: str, value: Any, count: int, like: Tensor) -> Tensor:
        """One number or one each, as (count,)."""
        value = torch.as_tensor(value, dtype=like.dtype, device=like.device)
        if value.shape not in ((), (count,)):
            raise ValueError(f"{name} of shape {tuple(value.shape)} was given; one number or {count} are wanted")
        self.named(name).check(name, value.detach().cpu())
        return value.expand(count)


@dataclass(frozen=True)
class Plant:
    """params: name -> () or, where it varies, (n,);  stepper: what advances the beam that they give."""

    params: dict[str, Tensor]
    stepper: Stepper | ExplicitStepper

    @property
    def scene(self) -> Scene:
        return self.stepper.scene


def aluminium_strip(dtype: torch.dtype = torch.float64) -> Section:
    """6061-T6 flat bar, 3 mm (along y) by 10 mm (along z): E = 68.9 GPa, nu = 0.33, density 2700 kg/m^3, yield 276 MPa."""
    values = (torch.tensor(v, dtype=dtype) for v in (3e-3, 10e-3, 68.9e9, 0.33, 2700.0))
    return Section.rectangle(*values)


def silicone_rod(dtype: torch.dtype = torch.float64) -> Section:
    """Round rod of silicone rubber, radius 10 mm: E = 1 MPa, nu = 0.45, density 1100 kg/m^3. Waves are slow enough in it for
    an explicit method: a fixed step of 0.5 ms is stable with two elements in 0.3 m.
    """
    values = (torch.tensor(v, dtype=dtype) for v in (0.01, 1e6, 0.45, 1100.0))
    return Section.circle(*values)


SECTIONS = {"aluminium strip": aluminium_strip, "silicone rod": silicone_rod}


def section_named(section: Section | str) -> Section:
    """The section itself, or the one of that name; ValueError where there is none."""
    if isinstance(section, Section):
        return section
    if not isinstance(section, str) or section not in SECTIONS:
        raise ValueError(f"section = {section!r} was given; a Section is wanted, or one of {', '.join(SECTIONS)}")
    return SECTIONS[section]()


def varied(section: Section, params: dict[str, Tensor], rows: Tensor) -> Section:
    """The section of the sub-envs `rows` with its stiffness and its mass multiplied by params["stiffness"] and ["mass"]."""
    compliance, mass = (x[rows] if x.ndim > 2 else x for x in (section.compliance, section.mass))
    stiffness, density = (params[name] for name in ("stiffness", "mass"))
    if stiffness.ndim == density.ndim == 0:
        return section if compliance is section.compliance and mass is section.mass else Section(compliance, mass)
    return Section(compliance / stiffness[..., None, None], mass * density[..., None, None])


def cantilever(length: float, elements: int, section: Section, effects: Iterable[Any], params: dict[str, Tensor],
               gravity: tuple[float, ...] | None, plane: str | None, **held: Any) -> Scene:
    """A straight beam along x under the effects of the task, damping params["damping"] (s, absent where None) and gravity."""
    length = torch.as_tensor(length, dtype=section.compliance.dtype, device=section.compliance.device)
    named = (Damping(params["damping"], six=False),) if "damping" in params else ()
    named += () if gravity is None else (Gravity(gravity),)
    return Scene(Beam.straight(length, elements, section), [*effects, *named], plane=plane, **held)


def stepper(scene: Scene, dt: float, form: str, method: str, solver: dict[str, Any]) -> Stepper | ExplicitStepper:
    """What advances the beam by dt (s): the implicit step (form "nodal", method "midpoint"), or torchdiffeq in any form."""
    if form == "nodal" and method in IMPLICIT_METHODS:
        return Stepper(scene, dt, method, **{"halvings": HALVINGS, **solver})
    return ExplicitStepper(scene, dt, method, form, **solver)


def first_frequency(section: Section, length: float) -> Tensor:
    """rad/s, (...): of the softer direction of a uniform cantilever, 1.8751^2 sqrt(EI / (m L^4))."""
    return 1.875104**2 / (softest(section) * section.mass[..., 0, 0] * length**4).sqrt()


def softest(section: Section) -> Tensor:
    """1/(N m^2), (...): the larger bending flexibility, 1/EI."""
    return section.compliance.diagonal(dim1=-2, dim2=-1)[..., 4:].amax(-1)
