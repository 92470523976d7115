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
from sim_bridge.kinematics import mass_matrix


class Friction(Record, Protocol):
    """Friction of one joint, joint side."""

    viscous: float  # [N m s/rad]
    coulomb_positive: float  # for positive speed, >= 0 [N m]
    coulomb_negative: float  # for negative speed, >= 0 [N m]
    speed: float  # scale of the smoothed Coulomb friction [rad/s]


FRICTION = record_dtype(Friction)


HOLD_FREQUENCY = 20.0  # w [rad/s]
NEWTON_STEPS = 50
LARGEST_SWEEPS = 1000
NEWTON_TOLERANCE = 1e-13


class Drive(Record, Protocol):
    """One drive: its rotor, over the gear, and the spring to its link."""

    q: float  # [rad]
    qd: float  # [rad/s]
    inertia: float  # of the rotor, joint side [kg m^2]
    stiffness: float  # of the spring [N m/rad]
    damping: float  # of the spring [N m s/rad]
    friction: Friction  # of the rotor


DRIVE = record_dtype(Drive)


def joint_friction(arm: Arm, scale: float, speed: float) -> Records[Friction]:
    """Return the friction of an arm times a scale, as records of `FRICTION`, shape (n,)."""
    joints = np.zeros(len(arm.links), dtype=FRICTION)
    for joint, link in zip(joints, arm.links):
        for name in ('viscous', 'coulomb_positive', 'coulomb_negative'):
            joint[name] = scale * getattr(link, name)
        joint['speed'] = speed
    return joints


def flexible_drives(
    inertia: ArrayLike,
    stiffness: ArrayLike,
    damping: ArrayLike,
    friction: Records[Friction],
) -> Records[Drive]:
    """Return rotors joined to the links by springs, records of `DRIVE`, shape (n,)."""
    drives = np.zeros(len(friction), dtype=DRIVE)
    drives['inertia'], drives['friction'] = inertia, friction
    drives['stiffness'], drives['damping'] = stiffness, damping
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
    Advance the rotors by one step and give what their springs do to the links.

    Of motor torques [N m], on the link side at angles [rad] and speeds [rad/s] at the start of the
    step [s], shape (n,). Symplectic Euler, in step with the links: springs and dampers as at the
    start of the step, friction as at its end (backward Euler). The springs' torques fill
    `link_torque`, shape (n,) [N m].
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
    acceleration with it (pinocchio's articulated-body algorithm): tau - Ja qdd makes the engine
    find the same. With the model of the arm with its armature, records of `FRICTION`, shape (n,),
    and the integration step [s].
    """

    def __init__(
        self, model: pin.Model, friction: Records[Friction], step: float
    ) -> None:
        self._model, self._data = model, model.createData()
        self._armature = np.array(model.armature)
        self._friction, self._step = friction, step
        self._frictionless = not any(
            friction[name].any()
            for name in ('viscous', 'coulomb_positive', 'coulomb_negative')
        )

    def advance(
        self,
        torque: Vector,
        total: Vector,
        q: Vector,
        qd: Vector,
        link_torque: Vector,
    ) -> None:
        """
        Fill `link_torque` with the torque on the links for one step, shape (n,) [N m].

        Of motor torques, and of these together with what all but gravity does to the joints, shape
        (n,) [N m], at the state at the start of the step, shape (n,) [rad], [rad/s].
        """
        acceleration = pin.aba(self._model, self._data, q, qd, total)
        if not self._frictionless:
            inertia = mass_matrix(self._model, self._data, q)
            speed = qd.copy()
            solve_joint_speeds(
                qd + self._step * acceleration,
                self._step,
                inertia,
                self._friction,
                speed,
            )
            slowed = (speed - qd) / self._step
            torque = torque - inertia @ (acceleration - slowed)
            acceleration = slowed
        np.subtract(torque, self._armature * acceleration, out=link_torque)


class PositionHold:
    """A gravity-compensated, critically damped joint servo: M (w^2 (q_0 - q) - 2 w qd) + g."""

    def __init__(self, model: pin.Model) -> None:
        self._model, self._data = model, model.createData()  # tool and rotors included
        self.posture: Vector | None = (
            None  # that is held [rad]; None takes the next one
        )

    def torque(self, q: Vector, qd: Vector) -> Vector:
        """Return the torque that holds the posture, shape (n,) [N m]."""
        if self.posture is None:
            self.posture = q.copy()
        w = HOLD_FREQUENCY
        acceleration = w * w * (self.posture - q) - 2.0 * w * qd
        still = np.zeros_like(q)
        gravity = pin.rnea(self._model, self._data, q, still, still)
        torque: Vector = (
            mass_matrix(self._model, self._data, q) @ acceleration + gravity
        )
        return torque


@compiled
def friction_torque(speed: float, joint: Friction) -> tuple[float, float]:
    """Return f(v) = b v + F tanh(v / v_0) of a joint [N m] and df/dv [N m s/rad] at a speed."""
    coulomb = joint.coulomb_positive if speed >= 0.0 else joint.coulomb_negative
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

    The solution [rad/s] lies between 0 and the speed without friction; Newton's method is kept
    inside a bracket that only shrinks, since tanh is too sharp for it alone.
    """
    low, high = min(0.0, free_speed), max(0.0, free_speed)
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
    (Gauss-Seidel) converges to its only zero, which takes the place of the first guess `speed`
    [rad/s]. M is the joint inertia with armature, shape (n, n) [kg m^2], `friction` records of
    `FRICTION`.
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
