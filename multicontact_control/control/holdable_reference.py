"""A reference that can be held: the arm stays where it is and presses as it does."""

from __future__ import annotations

from multicontact_control.arrays import Vector
from multicontact_control.control.reference import Reference, ReferenceSource
from multicontact_control.dynamics.pose import Pose
import numpy as np


class HoldableReference:
    """
    Hands on another reference, unless it is held.

    The time of the other one stands still meanwhile, so that a scenario goes on where it was.

    Parameters
    ----------
    source
        The other one.

    """

    def __init__(self, source: ReferenceSource) -> None:
        self._source = source
        self._held: Reference | None = None
        self._last: Reference | None = None
        self._last_time = self._lost_time = 0.0

    @property
    def held(self) -> bool:
        """Whether it is held."""
        return self._held is not None

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`. Ends a hold."""
        self._held = self._last = None
        self._last_time = self._lost_time = 0.0
        self._source.start(pose, normals_world)

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """Return the reference of one tick; see `ReferenceSource.update`."""
        if self._held is not None:
            self._lost_time += time - self._last_time
            self._last_time = time
            return self._held
        self._last_time = time
        self._last = self._source.update(time - self._lost_time, alpha_meas)
        return self._last

    def hold(self, pose: Pose) -> bool:
        """
        Hold a pose, and the desired forces.

        Parameters
        ----------
        pose
            Where the operational frame is.

        Returns
        -------
        bool
            Whether it can be: not before the first tick.

        """
        last = self._last
        if last is None:
            return False
        self._held = last._replace(
            pose_des=pose, twist_des=np.zeros(6), acceleration_des=np.zeros(6),
            active=last.active.copy(), alpha_des=last.alpha_des.copy())
        return True

    def release(self) -> None:
        """Go on with the other reference."""
        self._held = None
