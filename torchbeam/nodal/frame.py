"""Frame a at one instant: what its motion adds to velocities and spins, and to rates of vectors
told in its axes.

    v = v_r + v_a + omega x r        Omega = Omega_r + omega        dx/dt = x' + omega x x

of a point at r that moves with v_r in frame a, and of a vector x. What only a frame that moves asks
for is given as a function.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

from ..core.derivatives import cached
from ..core.leaves import Tree, leaf
from .coordinates.spatial import Spatial


@dataclass(frozen=True)
class FixedFrame(Tree):
    """A frame at rest. Velocities are (..., nodes, p) m/s and spins (..., nodes, s) rad/s."""

    space: Spatial

    turns = False

    def velocity(self, relative: Tensor, position: Tensor) -> Tensor:
        """Absolute velocity of points with a velocity relative to the frame."""
        return relative

    def spin(self, relative: Tensor) -> Tensor:
        """Absolute spin, frame a."""
        return relative

    def relative_velocity(self, velocity: Tensor, position: Tensor) -> Tensor:
        """The inverse of `velocity`."""
        return velocity

    def relative_spin(self, spin: Tensor, rotation: Tensor) -> Tensor:
        """Spin relative to the frame of an absolute one, both in section axes."""
        return spin

    def theta(self, relative: Tensor, rotation: Tensor, turn: Tensor, h: Tensor) -> Tensor:
        """Theta over h (..., 1, 1) s, absolute, section axes: `relative` is that of `turn`, after
        `rotation`, in the frame.
        """
        return relative

    def rate(self, rate: Tensor, vector: Callable[[], Tensor]) -> Tensor:
        """Absolute rate of a vector (..., p) with this rate in frame a."""
        return rate

    rate_by = rate  # of columns (..., p, n)
    spin_rate = rate  # of spins and angular momenta (..., s)
    spin_rate_by = rate  # of columns (..., s, n)

    def orientation(self, start: Tensor | None, dt: Tensor) -> Tensor | None:
        """Frame a -> inertial axes, dt (...) s after `start`; None where it does not turn."""
        return start

    def steady_acceleration(self, velocity: Tensor) -> dict[str, Tensor]:
        """Acceleration, by name, of points that keep their velocity relative to a frame that turns;
        else nothing.
        """
        return {}

    def steady_jacobian(self) -> dict[str, Tensor]:
        """Derivatives by the moves of points fixed in the frame, see `loads.MotionJacobian`."""
        return {}

    def moving_jacobian(self, eye: Tensor, spins: Tensor) -> dict[str, Tensor]:
        """The same by the moves and by their rates, summed; eye and spins are I of p and s."""
        return {"velocity": eye, "spin": spins}


@dataclass(frozen=True)
class TranslatingFrame(FixedFrame):
    """A frame whose origin moves with v (..., 1, p) m/s."""

    v: Tensor = leaf(2)

    def velocity(self, relative: Tensor, position: Tensor) -> Tensor:
        return relative + self.v

    def relative_velocity(self, velocity: Tensor, position: Tensor) -> Tensor:
        return velocity - self.v


@dataclass(frozen=True)
class TurningFrame(FixedFrame):
    """A frame that turns with omega (..., 1, s) rad/s about its origin, which moves as that of the
    frame `origin`.
    """

    origin: FixedFrame
    omega: Tensor = leaf(2)

    turns = True

    @cached
    def skew(self) -> Tensor:
        """~omega (..., 1, p, p)."""
        return self.space.skew(self.omega)

    @cached
    def spin_skew(self) -> Tensor:
        """~omega (..., 1, s, s)."""
        return self.space.spin_skew(self.omega)

    def velocity(self, relative: Tensor, position: Tensor) -> Tensor:
        return self.origin.velocity(relative, position) + self._across(position)

    def spin(self, relative: Tensor) -> Tensor:
        return self.omega + relative

    def relative_velocity(self, velocity: Tensor, position: Tensor) -> Tensor:
        return self.origin.relative_velocity(velocity, position) - self._across(position)

    def relative_spin(self, spin: Tensor, rotation: Tensor) -> Tensor:
        return spin - self.space.to_section(rotation, self.omega)

    def theta(self, relative: Tensor, rotation: Tensor, turn: Tensor, h: Tensor) -> Tensor:
        space = self.space
        after = space.multiply(space.cayley(self.omega * h), space.multiply(rotation, turn))
        return space.theta(space.multiply(space.inverse(rotation), after))

    def rate(self, rate: Tensor, vector: Callable[[], Tensor]) -> Tensor:
        return rate + self._across(vector())

    def rate_by(self, rate: Tensor, vector: Callable[[], Tensor]) -> Tensor:
        return rate + self.skew @ vector()

    def spin_rate(self, rate: Tensor, vector: Callable[[], Tensor]) -> Tensor:
        return rate + (self.spin_skew @ vector()[..., None])[..., 0]

    def spin_rate_by(self, rate: Tensor, vector: Callable[[], Tensor]) -> Tensor:
        return rate + self.spin_skew @ vector()

    def orientation(self, start: Tensor | None, dt: Tensor) -> Tensor:
        turn = self.space.exponential(self.omega[..., 0, :] * dt[..., None])
        # in single precision products drift off length 1
        return self.space.normalize(self.space.multiply(start, turn))

    def steady_acceleration(self, velocity: Tensor) -> dict[str, Tensor]:
        return {"acceleration": self._across(velocity)}

    def steady_jacobian(self) -> dict[str, Tensor]:
        return {"velocity": self.skew, "acceleration": self.skew @ self.skew}

    def moving_jacobian(self, eye: Tensor, spins: Tensor) -> dict[str, Tensor]:
        return {
            "velocity": self.skew + eye,
            "spin": spins,
            "acceleration": self.skew @ self.skew + 2 * self.skew,
            "angular_acceleration": self.spin_skew,
        }

    def _across(self, x: Tensor) -> Tensor:
        return (self.skew @ x[..., None])[..., 0]


def frame_of(space: Spatial, v: Tensor | None, omega: Tensor | None) -> FixedFrame:
    """From v and omega (..., 3), frame a; None = it does not move so."""
    frame = (
        FixedFrame(space)
        if v is None
        else TranslatingFrame(space, space.project_vector(v)[..., None, :])
    )
    return (
        frame
        if omega is None
        else TurningFrame(space, frame, space.project_spin(omega)[..., None, :])
    )
