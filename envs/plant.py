"""Plant: the simulated beam, as a function of parameters that may change between episodes."""

from __future__ import annotations

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from torchbeam import Beam, ExplicitStepper, Scene, Section, State, Stepper
from torchbeam.extend import METHODS, Tree, leaf, own_leaves, shown, warn

# a failed step is made again in 2 and 4 parts; more would cost the whole batch more than the
# episode is worth
HALVINGS = 2
# what torchdiffeq's methods and the mixed forms take
EXPLICIT = ("rtol", "atol", "options", "adjoint", "project", "solver")


@dataclass(frozen=True)
class Plant(Tree):
    """params: name -> () or, where it varies, (n,);  stepper: what advances the beam that they
    give.
    """

    params: dict[str, Tensor] = leaf(0)
    stepper: Stepper | ExplicitStepper

    @property
    def scene(self) -> Scene:
        return self.stepper.scene

    @property
    def native(self) -> bool:
        """Whether native code makes its steps."""
        return isinstance(self.stepper, Stepper) and self.stepper.compiled is not None

    def advance(
        self,
        beam: State,
        steps: int,
        active: Tensor | None,
        inputs: dict[str, Tensor] | list[dict[str, Tensor]],
    ) -> State:
        """The beam after so many steps with the inputs held, or with those of each step, where it
        is active (n,); None = everywhere.
        """
        if isinstance(self.stepper, Stepper) and isinstance(inputs, dict):
            return self.stepper.repeat(beam, steps, inputs, active)
        for given in [inputs] * steps if isinstance(inputs, dict) else inputs:
            beam = self.stepper.advance(beam, given, active=active)
        return beam


def aluminium_strip(dtype: torch.dtype | None = None) -> Section:
    """6061-T6 flat bar, 3 mm (along y) by 10 mm (along z): E = 68.9 GPa, nu = 0.33, density 2700
    kg/m^3, yield 276 MPa.

    Examples:
        >>> 1 / envs.aluminium_strip().compliance.diagonal()[4:]  # N m^2, bending about y and z
        tensor([17.2250,  1.5502])
    """
    _no_dtype(dtype)
    return Section.rectangle(3e-3, 10e-3, 68.9e9, 0.33, 2700.0)


def silicone_rod(dtype: torch.dtype | None = None) -> Section:
    """Round rod of silicone rubber, radius 10 mm: E = 1 MPa, nu = 0.45, density 1100 kg/m^3. Waves
    are slow enough in it for an explicit method: a fixed step of 0.5 ms is stable with two elements
    in 0.3 m.

    Examples:
        >>> 1 / envs.silicone_rod().compliance.diagonal()[4]  # N m^2, bending
        tensor(0.0079)
    """
    _no_dtype(dtype)
    return Section.circle(0.01, 1e6, 0.45, 1100.0)


def _no_dtype(dtype: torch.dtype | None) -> None:
    if dtype is not None:
        warn(
            "the dtype of a section goes in the next minor version: sections are of float64, and "
            "dtype=torch.float32 among an environment's keywords asks for single precision",
            DeprecationWarning,
        )


SECTIONS = {"aluminium strip": aluminium_strip, "silicone rod": silicone_rod}


def section_named(section: Section | str) -> Section:
    """The section itself, or the one of that name; ValueError where there is none."""
    if isinstance(section, Section):
        return section
    if not isinstance(section, str) or section not in SECTIONS:
        raise ValueError(
            f"section = {shown(section)} was given; a Section is wanted, or one of "
            f"{', '.join(SECTIONS)}"
        )
    return SECTIONS[section]()


def straight(
    length: float,
    elements: int,
    section: Section,
    direction: Sequence[float],
    up: Sequence[float] | None,
) -> Beam:
    """A straight beam; up = None: z, or for a beam along z, x."""
    up = (
        ((1.0, 0.0, 0.0) if direction[0] == direction[1] == 0 else (0.0, 0.0, 1.0))
        if up is None
        else up
    )
    return Beam.straight(length, elements, section, direction, up)


def varied(beam: Beam, params: Mapping[str, Tensor], rows: Tensor) -> Beam:
    """The beam of the sub-envs `rows`: rows of whatever it has a batch axis (num_envs,) of, its
    stiffness and its mass multiplied by params["stiffness"] and params["mass"].
    """
    own = {leaf.name: leaf.value[rows] for leaf in own_leaves(beam) if leaf.batch_shape}
    stiffness, mass = params["stiffness"], params["mass"]
    if stiffness.ndim or mass.ndim:
        own["compliance"] = (
            own.get("compliance", beam.compliance) / stiffness[..., None, None, None]
        )
        own["mass"] = own.get("mass", beam.mass) * mass[..., None, None, None]
    return replace(beam, **own) if own else beam


def check_solver(form: str, method: str, solver: Any) -> None:
    """ValueError where `solver` is no dictionary of arguments that this form's stepper takes."""
    implicit = form == "nodal" and method in METHODS
    names = list(inspect.signature(Stepper).parameters)[3:] if implicit else EXPLICIT
    if not isinstance(solver, Mapping):
        raise ValueError(
            f"solver = {shown(solver)} was given; a dictionary of arguments of the stepper is "
            "wanted"
        )
    for name in solver:
        if name not in names:
            raise ValueError(
                f"solver = {shown(dict(solver))} was given; the stepper of form = {shown(form)}, "
                f"method = {method!r} has {', '.join(names)}"
            )


def stepper(
    scene: Scene, dt: float, form: str, method: str, solver: Mapping[str, Any], engine: str = "auto"
) -> Stepper | ExplicitStepper:
    """Stepper that advances the beam by dt (s): the implicit step (form "nodal", method
    "midpoint"), or torchdiffeq.
    """
    if form == "nodal" and method in METHODS:
        return Stepper(scene, dt, method, **{"halvings": HALVINGS, "engine": engine, **solver})
    return ExplicitStepper(scene, dt, method, form, **solver)


def first_frequency(beam: Beam, length: float) -> Tensor:
    """rad/s, (...): 1.8751^2 sqrt(EI / (m L^4)), the first of a uniform cantilever of that length
    (m) with the beam's softest bending stiffness and its mean mass. A scale for what is observed;
    exact where that is what the beam is.
    """
    return 1.875104**2 / (softest(beam) * beam.mass[..., 0, 0].mean(-1) * length**4).sqrt()


def softest(beam: Beam) -> Tensor:
    """1/(N m^2), (...): the largest bending flexibility of the beam, 1/EI."""
    return beam.compliance.diagonal(dim1=-2, dim2=-1)[..., 4:].amax((-1, -2))
