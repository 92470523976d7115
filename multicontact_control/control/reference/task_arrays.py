"""A task in the arrays that compiled code works on."""

from __future__ import annotations

from multicontact_control.arrays import Mask, Vector
from multicontact_control.control.reference.source import Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.records import Records
import numpy as np


class TaskArrays:
    """
    Views of a record, which are kept because looking up a field takes long.

    Parameters
    ----------
    tasks
        One record of `TASK`.
    active, alpha_des
        What of contacts' records says which are asked for, and the forces, shape (r,).

    """

    def __init__(self, tasks: Records, active: Mask, alpha_des: Vector) -> None:
        task = tasks[0]
        self._position, self._rotation = task['position'], task['rotation']
        self._twist, self._acceleration = task['twist'], task['acceleration']
        self._active, self._alpha_des = active, alpha_des
        self._rotation[:] = np.eye(3)
        self.forget()

    def forget(self) -> None:
        """Something else has been written there: copy the next task whatever it is."""
        self._taken: Reference | None = None

    def take(self, task: Reference) -> None:
        """Copy what of a task is not the very object that was copied last."""
        last = self._taken
        if task is last:
            return
        position, rotation = task.pose_des
        self._position[:] = position
        self._twist[:], self._acceleration[:] = task.twist_des, task.acceleration_des
        if last is None or rotation is not last.pose_des.rotation_world:
            self._rotation[:] = rotation
        if last is None or task.active is not last.active or task.alpha_des is not last.alpha_des:
            self._active[:], self._alpha_des[:] = task.active, task.alpha_des
        self._taken = task

    def reference(self) -> Reference:
        """Return what is there; all but the pose is overwritten with it."""
        return Reference(
            Pose(self._position.copy(), self._rotation.copy()), self._twist, self._acceleration,
            self._active, self._alpha_des)
