"""What an engine does for a plant: an arm without surroundings, advanced step by step."""

from __future__ import annotations

from abc import ABC, abstractmethod

from multicontact_control.arrays import Matrix, Vector
import numpy as np


class EngineArm(ABC):
    """
    An arm of n joints alone in a world of its own; `reset` puts it there.

    Attributes
    ----------
    motion
        Joint angles and speeds now, shape (2, n) [rad, rad/s].
    q, qd
        Its rows.
    native_forces
        Normal forces of the engine's own contacts in the last step, shape (no,) [N]; None without.

    """

    def __init__(self, joint_count: int) -> None:
        self.motion: Matrix = np.zeros((2, joint_count))
        self.q: Vector = self.motion[0]
        self.qd: Vector = self.motion[1]
        self.native_forces: Vector | None = None

    @abstractmethod
    def reset(self, q: Vector) -> None:
        """Start afresh from rest at joint angles `q`; nothing of the past is left."""
        self.q[:], self.qd[:] = q, 0.0

    @abstractmethod
    def push(self, pushes: list[list[float]]) -> None:
        """
        Apply forces at points for one step.

        Of each x y z of force and of point, world axes [N], [m], and the number of a joint, for
        the link behind it, or n for the tool.
        """

    @abstractmethod
    def step(self, torque: Vector) -> tuple[float, ...]:
        """
        Advance `q` and `qd` by one step of symplectic Euler under torques, shape (n,) [N m].

        Return what the arm exerts on the tool at the start of the step, in the sensor's frame, six
        numbers [N, N m].
        """

    @abstractmethod
    def set_tool_mass(self, mass: float) -> None:
        """Let the tool weigh this much [kg]; its centre and the inertia about it stay."""

    def close(self) -> None:  # noqa: B027 - not every engine has anything to give back
        """Give the world back."""
