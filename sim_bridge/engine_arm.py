"""What an engine does for a plant: an arm without surroundings, advanced step by step."""

from __future__ import annotations

from abc import ABC, abstractmethod

from multicontact_control.arrays import Matrix, Vector
import numpy as np


class EngineArm(ABC):
    """
    An arm of n joints, alone in a world of its own, that an engine of rigid bodies moves.

    The plant works out all that acts on the arm (surfaces, hands, drives) and hands it over as
    forces and torques, so that every engine simulates the same contacts. `reset` comes first.

    Attributes
    ----------
    motion
        Joint angles and speeds now, shape (2, n) [rad, rad/s]; `step` writes into it.
    q, qd
        Its rows.
    native_forces
        Normal forces of the engine's own contacts in the last step, shape (no,) [N]; None for an
        engine without.

    """

    def __init__(self, joint_count: int) -> None:
        self.motion: Matrix = np.zeros((2, joint_count))
        self.q: Vector = self.motion[0]
        self.qd: Vector = self.motion[1]
        self.native_forces: Vector | None = None

    @abstractmethod
    def reset(self, q: Vector) -> None:
        """Start afresh at rest at joint angles, shape (n,) [rad], without any trace of before."""
        self.q[:] = q
        self.qd[:] = 0.0

    @abstractmethod
    def apply_pushes(self, pushes: list[list[float]]) -> None:
        """
        Apply forces at points of the arm for one step.

        Parameters
        ----------
        pushes
            Of each push seven numbers: x y z of the force [N], x y z of the point [m], both in
            world axes, and the number of a joint, for the link behind it, or n for the tool.

        """

    @abstractmethod
    def step(self, torque: Vector) -> tuple[float, ...]:
        """
        Advance angles and speeds by one step of symplectic Euler.

        Parameters
        ----------
        torque
            On the links, shape (n,) [N m].

        Returns
        -------
        tuple
            Wrench of the arm on the tool at the start of the step, in the sensor's frame: three
            forces [N] and three torques [N m].

        """

    @abstractmethod
    def set_tool_mass(self, mass: float) -> None:
        """Let the tool weigh this much [kg]; its centre and the inertia about it stay."""

    def close(self) -> None:  # noqa: B027 - not every engine has anything to free
        """Free what the engine holds outside Python's memory."""
