"""Flexible drives: rotors as bodies of their own behind springs and dampers, compiled."""

from __future__ import annotations

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np
from sim_bridge.joint_friction import implicit_speed


class FlexibleDrives:
    """
    Rotors joined to the links by springs, with friction on the rotors.

    Parameters
    ----------
    inertia
        Rotor inertia, joint side, shape (n,) [kg m^2].
    springs
        Stiffness and damping, shape (n, 2) [N m/rad], [N m s/rad].
    friction
        Friction table, shape (n, 4).
    step
        Integration step [s].

    Attributes
    ----------
    q, qd
        Rotor angles and speeds over the gear, shape (n,) [rad], [rad/s].

    """

    def __init__(self, inertia: Vector, springs: Matrix, friction: Matrix, step: float) -> None:
        self._inertia, self._springs = inertia, np.ascontiguousarray(springs)
        self._friction, self._step = friction, step
        self.q, self.qd = np.zeros(len(inertia)), np.zeros(len(inertia))

    def reset(self, q: Vector, torque: Vector) -> None:
        """Rest with the links at `q` [rad] and the springs wound up by `torque` [N m]."""
        self.q[:] = q + torque / self._springs[:, 0]
        self.qd[:] = 0.0

    def advance(self, torque: Vector, q: Vector, qd: Vector, joint_torque: Vector) -> None:
        """
        Advance the rotors by one step and fill in what the springs do to the links.

        Parameters
        ----------
        torque
            Motor torque, joint side, shape (n,) [N m].
        q, qd
            Link side at the start of the step, shape (n,) [rad], [rad/s].
        joint_torque
            Filled with the torque on the links, shape (n,) [N m].

        """
        advance_drives(torque, q, qd, self.q, self.qd, self._inertia, self._springs,
                       self._friction, self._step, joint_torque)


@compiled
def advance_drives(
    torque: Vector, q: Vector, qd: Vector, motor_q: Vector, motor_qd: Vector, inertia: Vector,
    springs: Matrix, friction: Matrix, step: float, joint_torque: Vector,
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
    motor_q, motor_qd
        Rotor side, over the gear; advanced in place.
    inertia
        Rotor inertia, joint side, shape (n,) [kg m^2].
    springs
        Stiffness and damping, shape (n, 2) [N m/rad], [N m s/rad].
    friction
        Friction table.
    step
        Length of the step [s].
    joint_torque
        Filled with the torque on the links, shape (n,) [N m].

    """
    for joint in range(q.shape[0]):
        twist = (springs[joint, 0] * (motor_q[joint] - q[joint])
                 + springs[joint, 1] * (motor_qd[joint] - qd[joint]))
        joint_torque[joint] = twist
        free = motor_qd[joint] + step / inertia[joint] * (torque[joint] - twist)
        motor_qd[joint] = implicit_speed(free, step, inertia[joint], friction[joint])
        motor_q[joint] += step * motor_qd[joint]
