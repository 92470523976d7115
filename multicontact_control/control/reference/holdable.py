"""A reference that can be held: the arm stays where it is and presses as it does."""

from __future__ import annotations

from typing import Protocol

from multicontact_control.arrays import Mask, Vector
from multicontact_control.config import ContactStateConfig
from multicontact_control.control.reference import Reference, ReferenceSource, TaskSource
from multicontact_control.dynamics.pose import Pose
import numpy as np


class HeldSource(ReferenceSource, TaskSource, Protocol):
    """A source that serves the control law alone and a supervisor."""


class HoldableReference:
    """
    Hands on another reference, unless it is held or locked.

    The time of the other one stands still meanwhile, so that a scenario goes on where it was.
    While it is locked the arm stays where it started, and no contact is asked for.

    Parameters
    ----------
    source
        The other one.
    locked
        Whether it is locked from the start.

    Attributes
    ----------
    locked
        Whether it is locked.

    """

    def __init__(self, source: HeldSource, *, locked: bool = False) -> None:
        self._source = source
        self.locked = locked
        self._count = 0
        self._held: Reference | None = None
        self._held_before = False  # on command, when it was locked
        self._last: Reference | None = None
        self._last_time = self._lost_time = 0.0

    @property
    def held(self) -> bool:
        """Whether it is held on command."""
        return self._held is not None and not self.locked

    @property
    def begun(self) -> bool:
        """Whether there is anything to be held: not before its first tick."""
        return self._last is not None

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`. Ends a hold, but no lock."""
        self._count = len(normals_world)
        self._held = self._standing(pose) if self.locked else None
        self._held_before = False
        self._last = None
        self._last_time = self._lost_time = 0.0
        self._source.start(pose, normals_world)

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """Return the reference of one tick; see `ReferenceSource.update`."""
        if self._held is not None:
            return self._stand(time, self._held)
        self._last_time = time
        self._last = self._source.update(time - self._lost_time, alpha_meas)
        return self._last

    def task(self, time: float) -> Reference:
        """Return the task of one tick; see `TaskSource.task`."""
        if self._held is not None:
            return self._stand(time, self._held)
        self._last_time = time
        self._last = self._source.task(time - self._lost_time)
        return self._last

    def contact_state(self, default: ContactStateConfig) -> ContactStateConfig:
        """Return how contacts are to be made; see `TaskSource.contact_state`."""
        return self._source.contact_state(default)

    def _stand(self, time: float, held: Reference) -> Reference:
        """Let the other one's time stand still."""
        self._lost_time += time - self._last_time
        self._last_time = time
        return held

    def hold(self, pose: Pose, active: Mask) -> None:
        """
        Hold a pose, and the desired forces; not before it has begun.

        Parameters
        ----------
        pose
            Where the operational frame is to stay.
        active
            Which contacts are force controlled, shape (r,); their forces are held.

        """
        last = self._last
        if last is not None:
            self._held = last._replace(
                pose_des=pose, twist_des=np.zeros(6), acceleration_des=np.zeros(6),
                active=active.copy(), alpha_des=np.where(active, last.alpha_des, 0.0))

    def release(self) -> None:
        """Go on with the other reference, unless this one is locked."""
        if not self.locked:
            self._held = None

    def lock(self, pose: Pose | None = None) -> None:
        """Ask for a pose and no contact until `unlock`; for that of the next start if None."""
        self._held_before = self.held or self.locked and self._held_before
        self.locked = True
        if pose is not None:
            self._held = self._standing(pose)

    def _standing(self, pose: Pose) -> Reference:
        none: Mask = np.zeros(self._count, dtype=bool)
        return Reference(pose, np.zeros(6), np.zeros(6), none, np.zeros(self._count))

    def unlock(self) -> None:
        """
        Begin with the other reference, where its time has stood still.

        Not if it was held when it was locked: then it still is, with no contact.
        """
        self.locked = False
        if not self._held_before:
            self._held = None
        self._held_before = False
