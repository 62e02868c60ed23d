"""A beam that moves in a plane: two positions, one angle and three strains of the same mathematics.

The plane has the axes e_1, e_2 (two of frame a) and the normal e_3; a section has its axes 1
(along the beam), t in the plane and n = e_3. A rotation is (cos(phi/2), sin(phi/2)): what is left
of the quaternion. Strains are [gamma_1, gamma_t, kappa_n].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import pad

from ...core.derivatives import cached
from ...core.leaves import leaf, with_values
from ...core.remembered import remembered
from ...core.validation import concrete
from ...math import quaternions as quat
from ...math.columns import Columns, Run
from ...scene.beam import Beam
from ...state.state import State
from . import planar_element as element
from .spatial import Dimensions, Spatial

# e_1, e_2, e_3
PLANES = {
    "xy": ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)),
    "xz": ((1.0, 0, 0), (0, 0, 1.0), (0, -1.0, 0)),
}
# of [1 t n 1 t n]: strains that a plane has, and those it has not
INSIDE, OUTSIDE = [0, 1, 5], [2, 3, 4]
CLOSE = {torch.float64: 1e-9, torch.float32: 1e-5}
LEFT_OUT = {torch.float64: 1e-6, torch.float32: 1e-3}  # of a state given to start from


class Maps(NamedTuple):
    """Of a plane: the public quaternion of (cos, sin), (2, 4); the six of a section from those
    inside the plane, then those outside, (6, 6); inside ones alone, (6, 3), of stress or strain,
    and of diagonals of their matrices; loads to those in the plane, (6, 3), and back, (3, 6).
    """

    rotation: Tensor
    section: Tensor
    stress: Tensor
    diagonal: Tensor
    load: Tensor
    embedding: Tensor
    to_rotation: Columns
    to_stress: Columns
    to_load: Columns
    to_vector: Columns
    to_normal: Columns

    @classmethod
    def of(cls, basis: Tensor, section: Tensor) -> Maps:
        units = torch.eye(4, dtype=basis.dtype, device=basis.device)[[0, 3]]
        rotation = quat.multiply(quat.from_matrix(basis), units)
        rotation = quat.multiply(rotation, quat.from_matrix(section.mT))
        # two quarter turns are exact, as states come back to the bit only by such maps
        near = rotation.round()
        rounding = 4 * torch.finfo(rotation.dtype).eps
        rotation = torch.where((rotation - near).abs() < rounding, near, rotation)
        whole = torch.block_diag(section, section)[:, INSIDE + OUTSIDE]
        stress = whole[:, : len(INSIDE)]
        load = torch.block_diag(basis[:, :2], basis[:, 2:])
        public = rotation, stress.mT, load.mT, basis[:, :2].mT, basis[:, 2:].mT
        columns = map(Columns.of, public)
        return cls(rotation, whole, stress, stress.abs(), load, load.mT, *columns)


torch.serialization.add_safe_globals([Maps, Columns, Run])


@dataclass(frozen=True)
class Planar(Spatial):
    """See above. Maps from 3D and back are constant matrices.

    name    "xy" or "xz"
    basis   (3, 3) columns e_1, e_2, e_3;  section (3, 3) columns: section axes 1, t, n
    place   0-dim m, of the plane along e_3
    """

    name: str
    basis: Tensor = leaf(2)
    section: Tensor = leaf(2)
    place: Tensor = leaf(0)

    dims: ClassVar[Dimensions] = Dimensions(position=2, spin=1, strain=3)

    functions = property(lambda self: self.element.planar)

    multiply = staticmethod(element.multiply)
    inverse = staticmethod(element.inverse)
    matrix = staticmethod(element.matrix)

    @property
    def plane(self) -> str:
        return self.name

    @classmethod
    def of(cls, beam: Beam, name: str) -> Planar:
        """Raises ValueError where the beam or its mass leaves the plane `name`."""
        numbers = (x.detach() for x in (beam.nodes, beam.frames, beam.elements, beam.length))
        plane = remembered(cls._through, name, beam.order, bool(beam.parts), *numbers)
        if beam.offset or beam.rotary:
            plane.check_section("mass", beam.mass.detach())
        return plane

    @classmethod
    def _through(
        cls,
        name: str,
        order: int,
        several: bool,
        nodes: Tensor,
        frames: Tensor,
        elements: Tensor,
        length: Tensor,
    ) -> Planar:
        """Of a beam's nodes, see `Beam`; several: whether it has parts."""
        close = CLOSE.get(nodes.dtype, 1e-5)
        basis = torch.tensor(PLANES[name], dtype=nodes.dtype, device=nodes.device).mT
        normal = basis[:, 2]
        place = nodes @ normal
        size = length.sum(-1).amax()
        if concrete((place - place.flatten()[0]).abs() > close * size).any():
            raise ValueError(
                f"nodes out of the plane {name!r} were given; a beam in a plane of that "
                "direction is wanted"
            )
        across = torch.cat(
            [(quat.matrix(q).mT @ normal).flatten(0, -2) for q in (frames, elements)]
        )
        # within torch.func.vmap that of all samples
        n = concrete(across[0]).reshape(-1, 3)[0].round()
        if concrete((across - n).abs() > close).any() or n[0] != 0:
            alike = ", the same in all parts (up= turns it)," if several else ""
            raise ValueError(
                f"section axes at an angle to the plane {name!r} were given; y or z of every "
                f"section{alike} is wanted along its normal"
            )
        e = torch.zeros_like(n)
        e[0] = 1
        section = torch.stack((e, torch.linalg.cross(n, e), n), -1)
        return cls(name, basis, section, place.flatten()[0], order=order)

    def check_section(self, what: str, given: Tensor) -> None:
        """Refuse a section's matrix that couples what is in the plane to what is out of it."""
        local = self._section_map.mT @ given @ self._section_map
        scale = local.diagonal(dim1=-2, dim2=-1).abs().sqrt()
        inside, outside = scale[..., : len(INSIDE), None], scale[..., None, len(INSIDE) :]
        coupling = local[..., : len(INSIDE), len(INSIDE) :].abs()
        if concrete(coupling > CLOSE.get(given.dtype, 1e-5) * inside * outside).any():
            raise ValueError(
                f"a section whose {what} couples the plane {self.name!r} to what is out of it was "
                "given; plane=None takes it"
            )

    @cached
    def _maps(self) -> Maps:
        return remembered(Maps.of, self.basis, self.section)

    _rotation_map = property(lambda self: self._maps.rotation)
    _section_map = property(lambda self: self._maps.section)
    _stress_map = property(lambda self: self._maps.stress)
    _diagonal_map = property(lambda self: self._maps.diagonal)
    _load_map = property(lambda self: self._maps.load)
    _embedding = property(lambda self: self._maps.embedding)

    @cached
    def _vector_map(self) -> Tensor:
        """(3, 2)"""
        return self.basis[:, :2]

    @cached
    def _origin(self) -> Tensor:
        """(3,) m: the point of the plane that is nearest to frame a's."""
        return self.place * self.basis[:, 2]

    @cached
    def _quaternion_map(self) -> Tensor:
        """(4, 2): the inverse of `_rotation_map`."""
        return self._rotation_map.mT

    @cached
    def _section_normal(self) -> Tensor:
        """(3, 1)"""
        return self.section[:, 2:]

    @cached
    def section_axes(self) -> tuple[float, ...]:
        """The numbers of `section`."""
        return tuple(self.section.flatten().tolist())

    @cached
    def reversible(self) -> bool:
        """Whether a state that went to 3D comes back to the bit: the maps move numbers, and change
        signs at most.
        """
        maps = self.basis, self.section, self._rotation_map
        return all(bool(((x == 0) | (x.abs() == 1)).all()) for x in maps)

    def to_reduced(self, state: State) -> State:
        position, rotation = self.pose(state.position, state.rotation)
        velocity, spin = self.motion(state.velocity, state.spin)
        return with_values(
            state,
            position=position,
            rotation=rotation,
            velocity=velocity,
            spin=spin,
            stress=state.stress @ self._stress_map,
            reaction=state.reaction @ self._load_map,
            frame=None if state.frame is None else self.reduced_frame(state.frame),
            **_crept(state, 6, self.project_strain),
        )

    def start(self, state: State) -> State:
        inside = self.to_reduced(state)
        there = self.to_public(inside)
        for name in ("position", "rotation", "velocity", "spin") if state.position.numel() else ():
            given, reduced = (getattr(x, name).detach() for x in (state, there))
            size = given.abs().amax() + (name != "rotation") * state.position.detach().abs().amax()
            if concrete((given - reduced).abs() > LEFT_OUT[given.dtype] * size).any():
                raise ValueError(
                    f"an initial state whose {name} leaves the plane {self.name!r} was given; one "
                    "in it is wanted, or plane=None"
                )
        return inside

    def public_frame(self, q: Tensor) -> Tensor:
        return torch.cat((q[..., :1], q[..., 1:] * self.basis[:, 2]), -1)

    def to_public(self, state: State) -> State:
        frame = None if state.frame is None else self.public_frame(state.frame)
        return with_values(
            state,
            position=self.public_position(state.position),
            rotation=self._maps.to_rotation(state.rotation),
            velocity=self.public_vector(state.velocity),
            spin=state.spin @ self.section[:, 2:].mT,
            stress=self._maps.to_stress(state.stress),
            reaction=self._maps.to_load(state.reaction),
            frame=frame,
            **_crept(state, self.dims.strain, self.embed_strain),
        )

    def reduced_frame(self, q: Tensor) -> Tensor:
        return torch.cat((q[..., :1], q[..., 1:] @ self.basis[:, 2:]), -1)

    def pose(self, position: Tensor, rotation: Tensor) -> tuple[Tensor, Tensor]:
        return position @ self._vector_map, rotation @ self._quaternion_map

    def motion(self, velocity: Tensor, spin: Tensor) -> tuple[Tensor, Tensor]:
        return velocity @ self._vector_map, spin @ self._section_normal

    def embed(self, load: Tensor) -> Tensor:
        return load @ self._embedding.to(load.dtype)  # motions of modes are complex

    def project(self, load: Tensor) -> Tensor:
        return load @ self._load_map

    def project_map(self, by: Tensor) -> Tensor:
        return self._load_map.mT @ by @ self._load_map

    def project_strain(self, strain: Tensor) -> Tensor:
        return strain @ self._stress_map

    def embed_strain(self, strain: Tensor) -> Tensor:
        """(..., k) -> (..., 6), frame B."""
        return strain @ self._stress_map.mT

    def project_section(self, matrix: Tensor) -> Tensor:
        return self._stress_map.mT @ matrix @ self._stress_map

    def project_diagonal(self, diagonal: Tensor) -> Tensor:
        return diagonal @ self._diagonal_map

    def project_inertia(self, J: Tensor) -> Tensor:
        n = self.section[:, 2]  # a unit vector of the section, whatever its sign
        return (J @ n * n).sum(-1)[..., None, None]

    def project_offset(self, e: Tensor) -> Tensor:
        return e @ self.section[:, :2]

    def project_vector(self, v: Tensor) -> Tensor:
        return v @ self._vector_map

    def project_spin(self, omega: Tensor) -> Tensor:
        return omega @ self.basis[:, 2:]

    def public_position(self, position: Tensor) -> Tensor:
        return self._maps.to_vector(position, self._origin)

    def public_vector(self, v: Tensor) -> Tensor:
        return self._maps.to_vector(v)

    def public_spin(self, spin: Tensor) -> Tensor:
        return self._maps.to_normal(spin)

    def axes(self, rotation: Tensor) -> Tensor:
        return quat.matrix(rotation @ self._rotation_map)

    def constrained(self, letters: tuple[bool, ...]) -> tuple[bool, ...]:
        at = [[abs(x) for x in e].index(1.0) for e in PLANES[self.name]]
        return letters[at[0]], letters[at[1]], letters[3 + at[2]]

    def identity(self, like: Tensor) -> Tensor:
        return pad(torch.zeros_like(like[..., :1]), (1, 0), value=1.0)

    def theta_by_turn(self, theta: Tensor) -> Tensor:
        return (1 + theta * theta / 4)[..., None]

    def exponential(self, phi: Tensor) -> Tensor:
        return torch.cat((torch.cos(phi / 2), torch.sin(phi / 2)), -1)

    def logarithm(self, q: Tensor) -> Tensor:
        q = torch.where(q[..., :1] < 0, -q, q)
        return 2 * torch.atan2(q[..., 1:], q[..., :1])

    def logarithm_by_turn(self, q: Tensor) -> Tensor:
        return torch.ones_like(q[..., :1, None])

    def to_frame(self, q: Tensor, spin: Tensor) -> Tensor:
        return spin

    def to_reduced_rotation(self, q: Tensor) -> Tensor:
        return q @ self._quaternion_map

    def to_section(self, q: Tensor, spin: Tensor) -> Tensor:
        return spin

    def spin_matrix(self, q: Tensor) -> Tensor:
        return torch.ones_like(q[..., :1, None])

    def spin_skew(self, spin: Tensor) -> Tensor:
        return torch.zeros_like(spin)[..., None]

    def mean_rotation(self, R: Tensor, before: Tensor) -> Tensor:
        return torch.ones_like(R)

    def lever_matrix(self, x: Tensor) -> Tensor:
        return element.turned(x)[..., None]

    def skew(self, omega: Tensor) -> Tensor:
        return omega[..., None] * torch.tensor(
            ((0.0, -1), (1, 0)), dtype=omega.dtype, device=omega.device
        )


def _crept(state: State, size: int, to: Callable[[Tensor], Tensor]) -> dict[str, Tensor]:
    """What arms have crept by, of each of these so many strains by a map of strains."""
    if state.inelastic is None:
        return {}
    return {"inelastic": to(state.inelastic.unflatten(-1, (-1, size))).flatten(-2)}
