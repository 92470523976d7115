"""What an engine does for a plant: an arm without surroundings, advanced step by step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from multicontact_control.arrays import Vector
import numpy as np


class EngineArm(ABC):
    """
    One arm alone in a world of its own; `reset` puts it there.

    Parameters
    ----------
    joint_count
        n.

    Attributes
    ----------
    q, qd
        Joint angles and speeds now, shape (n,) [rad], [rad/s].

    """

    # The engine's names for the tool, and for the link behind each joint.
    _tool: Any
    _links: Sequence[Any]

    def __init__(self, joint_count: int) -> None:
        self.q: Vector = np.zeros(joint_count)
        self.qd: Vector = np.zeros(joint_count)

    def reset(self, q: Vector) -> None:
        """Start afresh from rest at joint angles `q`; nothing of the past is left."""
        self._place(q)
        self.q[:], self.qd[:] = q, 0.0

    @abstractmethod
    def _place(self, q: Vector) -> None:
        """Make the world anew, with the arm at rest at joint angles `q`."""

    def push_tool(self, force: list[float], point: list[float]) -> None:
        """Apply a force [N] at a point [m] of the tool for one step, world axes."""
        self._push(self._tool, force, point)

    def push_link(self, joint: int, force: list[float], point: list[float]) -> None:
        """Apply a force [N] at a point [m] of the link behind a joint for one step, world axes."""
        self._push(self._links[joint], force, point)

    @abstractmethod
    def _push(self, link: Any, force: list[float], point: list[float]) -> None:
        """Apply a force [N] at a point [m] of a link for one step, world axes."""

    @abstractmethod
    def step(self, torque: Vector) -> tuple[float, ...]:
        """
        Advance `q` and `qd` by one step under joint torques, shape (n,) [N m].

        Symplectic Euler: the speeds with the acceleration at the start, then the angles with the
        new speeds.

        Returns
        -------
        tuple of float
            What the arm exerts on the tool at the start of the step, in the sensor's frame, six
            numbers [N, N m].

        """

    def native_forces(self) -> Vector:
        """Return the normal forces of the engine's own contacts in that step, shape (no,) [N]."""
        return np.zeros(0)

    def close(self) -> None:  # noqa: B027 - not every engine has anything to give back
        """Give the world back."""
