"""Flexible drives: rotors as bodies of their own behind springs and dampers, compiled."""

from __future__ import annotations

from typing import Any

from multicontact_control.arrays import Vector
from multicontact_control.compiled import compiled
from multicontact_control.records import Records
import numpy as np
from sim_bridge.joint_friction import implicit_speed

# One drive: its rotor, over the gear, and the spring to its link.
DRIVE = np.dtype([
    ('q', np.float64),  # [rad]
    ('qd', np.float64),  # [rad/s]
    ('inertia', np.float64),  # of the rotor, joint side [kg m^2]
    ('stiffness', np.float64),  # of the spring [N m/rad]
    ('damping', np.float64),  # of the spring [N m s/rad]
])


class FlexibleDrives:
    """
    Rotors joined to the links by springs, with friction on the rotors.

    Parameters
    ----------
    inertia
        Rotor inertia, joint side, shape (n,) [kg m^2].
    stiffness, damping
        Of the springs, shape (n,) [N m/rad], [N m s/rad].
    friction
        Records of `FRICTION`, shape (n,).
    step
        Integration step [s].

    Attributes
    ----------
    q, qd
        Rotor angles and speeds over the gear, shape (n,) [rad], [rad/s].

    """

    def __init__(
        self, inertia: Vector, stiffness: Vector, damping: Vector, friction: Records, step: float,
    ) -> None:
        self._drives: Any = np.zeros(len(inertia), dtype=DRIVE)
        self._drives['inertia'] = inertia
        self._drives['stiffness'], self._drives['damping'] = stiffness, damping
        self._friction, self._step = friction, step
        self.q: Vector = self._drives['q']
        self.qd: Vector = self._drives['qd']

    def reset(self, q: Vector, torque: Vector) -> None:
        """Rest with the links at `q` [rad] and the springs wound up by `torque` [N m]."""
        self.q[:] = q + torque / self._drives['stiffness']
        self.qd[:] = 0.0

    def advance(self, torque: Vector, q: Vector, qd: Vector, joint_torque: Vector) -> None:
        """Advance the rotors by one step; see `advance_drives`."""
        advance_drives(
            torque, q, qd, self._drives, self._friction, self._step, joint_torque)


@compiled
def advance_drives(
    torque: Vector, q: Vector, qd: Vector, drives: Any, friction: Any, step: float,
    joint_torque: Vector,
) -> None:
    """
    Advance the rotors by one step and give what their springs do to the links.

    Symplectic Euler, in step with the links: springs and dampers as at the start of the step,
    friction as at its end (backward Euler).

    Parameters
    ----------
    torque
        Motor torque, joint side, shape (n,) [N m].
    q, qd
        Link side of the joints at the start of the step, shape (n,) [rad], [rad/s].
    drives, friction
        Records of `DRIVE`, advanced in place, and `FRICTION`, shape (n,).
    step
        Length of the step [s].
    joint_torque
        Filled with the torque on the links, shape (n,) [N m].

    """
    for joint in range(q.shape[0]):
        drive = drives[joint]
        twist = drive.stiffness * (drive.q - q[joint]) + drive.damping * (drive.qd - qd[joint])
        joint_torque[joint] = twist
        free = drive.qd + step / drive.inertia * (torque[joint] - twist)
        drive.qd = implicit_speed(free, step, drive.inertia, friction[joint])
        drive.q += step * drive.qd
