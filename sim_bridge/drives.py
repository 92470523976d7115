"""
The drives: rotors behind springs, or rotors that turn with the links; their friction.

Without commands they hold their position.
"""

from __future__ import annotations

from typing import Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.records import (
    Record,
    record_dtype,
    Records,
)
import numpy as np
from numpy.typing import ArrayLike
import pinocchio as pin
from sim_bridge.arm import Arm

HOLD_FREQUENCY = 20.0  # w [rad/s]
NEWTON_STEPS = 50
LARGEST_SWEEPS = 1000
NEWTON_TOLERANCE = 1e-13
FRICTION_TORQUES = ('viscous', 'coulomb_positive', 'coulomb_negative')


class Friction(Record, Protocol):
    """Friction of one joint, joint side: b v + F tanh(v / v_0), F by the sign of v."""

    viscous: float  # b [N m s/rad]
    coulomb_positive: float  # F for positive speed, >= 0 [N m]
    coulomb_negative: float  # F for negative speed, >= 0 [N m]
    speed: float  # v_0, scale of the smoothed Coulomb friction [rad/s]


FRICTION = record_dtype(Friction)


class Drive(Record, Protocol):
    """One drive: its rotor, seen through the gear, and the spring to its link."""

    q: float  # of the rotor, joint side [rad]
    qd: float  # of the rotor, joint side [rad/s]
    inertia: float  # of the rotor, joint side [kg m^2]
    stiffness: float  # of the spring [N m/rad]
    damping: float  # of the spring [N m s/rad]
    friction: Friction  # of the rotor


DRIVE = record_dtype(Drive)


def joint_friction(arm: Arm, scale: float, speed: float) -> Records[Friction]:
    """
    Return the friction of an arm's joints as records of `FRICTION`, shape (n,).

    Torques are those of the arm times `scale`; `speed` is the scale of the smoothed Coulomb
    friction [rad/s].
    """
    joints = np.zeros(len(arm.links), dtype=FRICTION)
    for name in FRICTION_TORQUES:
        joints[name] = [scale * getattr(link, name) for link in arm.links]
    joints['speed'] = speed
    return joints


def flexible_drives(
    inertia: ArrayLike,
    stiffness: ArrayLike,
    damping: ArrayLike,
    friction: Records[Friction],
) -> Records[Drive]:
    """
    Return rotors joined to the links by springs, at rest at angle 0.

    Parameters
    ----------
    inertia
        Of the rotors, joint side, shape (n,) [kg m^2].
    stiffness, damping
        Of the springs, shape (n,) [N m/rad], [N m s/rad].
    friction
        Of the rotors, records of `FRICTION`, shape (n,).

    Returns
    -------
    Records
        Of `DRIVE`, shape (n,).

    """
    drives = np.zeros(len(friction), dtype=DRIVE)
    drives['inertia'] = inertia
    drives['stiffness'] = stiffness
    drives['damping'] = damping
    drives['friction'] = friction
    return drives


@compiled
def advance_drives(
    torque: Vector,
    q: Vector,
    qd: Vector,
    drives: Records[Drive],
    step: float,
    link_torque: Vector,
) -> None:
    """
    Advance the rotors by one step and find out what their springs do to the links.

    Symplectic Euler, in step with the links: springs and dampers as at the start of the step,
    friction as at its end (backward Euler).

    Parameters
    ----------
    torque
        Of the motors, joint side, shape (n,) [N m].
    q, qd
        Angles [rad] and speeds [rad/s] of the links at the start of the step, shape (n,).
    drives
        Records of `DRIVE`, shape (n,) or none; angle and speed of the rotors are advanced.
    step
        [s].
    link_torque
        Filled with the torques of the springs on the links, shape (n,) [N m].

    """
    for joint in range(drives.shape[0]):
        drive = drives[joint]
        twist = drive.stiffness * (drive.q - q[joint]) + drive.damping * (
            drive.qd - qd[joint]
        )
        link_torque[joint] = twist
        free = drive.qd + step / drive.inertia * (torque[joint] - twist)
        drive.qd = solve_joint_speed(free, step, drive.inertia, drive.friction)
        drive.q += step * drive.qd


class RigidDrives:
    """
    The torque that makes links without rotors move as links with rotors do.

    PyBullet has no armature Ja, nor does MuJoCo here. All forces are known, and so is the
    acceleration qdd of the arm with its armature (pinocchio's articulated-body algorithm):
    tau - Ja qdd makes the engine find the same.

    Parameters
    ----------
    model
        The arm with its armature; the plant changes its tool's mass.
    friction
        Records of `FRICTION`, shape (n,).
    step
        Integration step [s].

    """

    def __init__(
        self, model: pin.Model, friction: Records[Friction], step: float
    ) -> None:
        self._model = model
        self._data = model.createData()
        self._armature = np.array(model.armature)
        self._friction = friction
        self._step = step
        self._has_friction = any(friction[name].any() for name in FRICTION_TORQUES)

    def find_link_torque(
        self,
        torque: Vector,
        total: Vector,
        q: Vector,
        qd: Vector,
        link_torque: Vector,
    ) -> None:
        """
        Fill `link_torque` with the torque on the links for one step, shape (n,) [N m].

        Parameters
        ----------
        torque
            Of the motors, shape (n,) [N m].
        total
            Motor torques and what all but gravity does to the joints, shape (n,) [N m].
        q, qd
            At the start of the step, shape (n,) [rad], [rad/s].
        link_torque
            Filled in.

        """
        acceleration = pin.aba(self._model, self._data, q, qd, total)
        if self._has_friction:
            inertia = pin.crba(self._model, self._data, q)
            free_speed = qd + self._step * acceleration
            speed = qd.copy()
            solve_joint_speeds(free_speed, self._step, inertia, self._friction, speed)
            slowed = (speed - qd) / self._step
            torque = torque - inertia @ (acceleration - slowed)
            acceleration = slowed
        np.subtract(torque, self._armature * acceleration, out=link_torque)


class PositionHold:
    """
    A gravity-compensated, critically damped joint servo: M (w^2 (q_0 - q) - 2 w qd) + g.

    Drives without commands hold their position so, as those of a real robot do.

    Parameters
    ----------
    model
        The arm with tool and armature.

    Attributes
    ----------
    posture
        q_0, shape (n,) [rad]; None lets the next call take the angles it is given.

    """

    def __init__(self, model: pin.Model) -> None:
        self._model = model
        self._data = model.createData()
        self.posture: Vector | None = None

    def holding_torque(self, q: Vector, qd: Vector) -> Vector:
        """Return the torque at angles [rad] and speeds [rad/s], all of shape (n,) [N m]."""
        if self.posture is None:
            self.posture = q.copy()
        w = HOLD_FREQUENCY
        acceleration = w * w * (self.posture - q) - 2.0 * w * qd
        gravity = pin.computeGeneralizedGravity(self._model, self._data, q)
        inertia = pin.crba(self._model, self._data, q)
        torque: Vector = inertia @ acceleration + gravity
        return torque


@compiled
def friction_torque(speed: float, joint: Friction) -> tuple[float, float]:
    """
    Return the friction of a joint at a speed v [rad/s] and how it changes with it.

    f(v) = b v + F tanh(v / v_0) [N m], and df/dv [N m s/rad].
    """
    coulomb = joint.coulomb_negative
    if speed >= 0.0:
        coulomb = joint.coulomb_positive
    tangent = np.tanh(speed / joint.speed)
    return (
        joint.viscous * speed + coulomb * tangent,
        joint.viscous + coulomb * (1.0 - tangent * tangent) / joint.speed,
    )


@compiled
def solve_joint_speed(
    free_speed: float, step: float, inertia: float, joint: Friction
) -> float:
    """
    Solve v = free_speed - step / inertia * f(v) for the speed at the end of a step.

    The solution lies between 0 and the speed without friction; Newton's method is kept inside a
    bracket that only shrinks, since tanh is too sharp for it alone.

    Parameters
    ----------
    free_speed
        Speed at the end of the step without friction [rad/s].
    step
        [s].
    inertia
        Joint side [kg m^2].
    joint
        A record of `FRICTION`.

    Returns
    -------
    float
        v [rad/s].

    """
    low = min(0.0, free_speed)
    high = max(0.0, free_speed)
    ratio = step / inertia
    speed = free_speed
    # Small speeds stick: start where tanh is straight if the whole of the friction stops it.
    if abs(free_speed) < ratio * max(joint.coulomb_positive, joint.coulomb_negative):
        speed = free_speed / (1.0 + ratio * friction_torque(0.0, joint)[1])
    for _ in range(NEWTON_STEPS):
        friction, slope = friction_torque(speed, joint)
        residual = speed - free_speed + ratio * friction
        if residual > 0.0:
            high = speed
        else:
            low = speed
        following = speed - residual / (1.0 + ratio * slope)
        if not low <= following <= high:
            following = 0.5 * (low + high)
        if abs(following - speed) <= NEWTON_TOLERANCE * (1.0 + abs(speed)):
            return following
        speed = following
    return speed


@compiled
def solve_joint_speeds(
    free_speed: Vector,
    step: float,
    mass_matrix: Matrix,
    friction: Records[Friction],
    speed: Vector,
) -> None:
    """
    Solve M (v - free_speed) + step f(v) = 0 for the speeds of joints that move each other.

    The left side is the gradient of a convex function, so that one joint after the other
    (Gauss-Seidel) converges to its only zero.

    Parameters
    ----------
    free_speed
        Speeds at the end of the step without friction, shape (n,) [rad/s].
    step
        [s].
    mass_matrix
        M, joint inertia with armature, shape (n, n) [kg m^2].
    friction
        Records of `FRICTION`, shape (n,).
    speed
        First guess, replaced by the solution v, shape (n,) [rad/s].

    """
    n = free_speed.shape[0]
    for _ in range(LARGEST_SWEEPS):
        largest = 0.0
        for joint in range(n):
            moved = 0.0  # by the other joints
            for other in range(n):
                if other != joint:
                    moved -= mass_matrix[joint, other] * (
                        speed[other] - free_speed[other]
                    )
            inertia = mass_matrix[joint, joint]
            before = speed[joint]
            speed[joint] = solve_joint_speed(
                free_speed[joint] + moved / inertia, step, inertia, friction[joint]
            )
            largest = max(largest, abs(speed[joint] - before))
        if largest <= NEWTON_TOLERANCE:
            return
