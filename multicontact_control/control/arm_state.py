"""Where the arm is and what its model says there, as the law and its supervision share it."""

from __future__ import annotations

from typing import Any

from multicontact_control.algebra import copy_matrix, copy_vector
from multicontact_control.arrays import Matrix, require_shape, Vector
from multicontact_control.compiled import compile_for, compiled
from multicontact_control.control.momentum import observe_momentum, wrench_of_residual
from multicontact_control.control.wrench import measure_contacts
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.records import CONTACT, CONTROL, JOINT
import numpy as np

# What `see_arm` returns: that the model gave no numbers, or what is unusual, added up.
NO_NUMBERS = -1
OPERATIONAL_SPEED, JOINT_SPEED, AMBIGUOUS, TOUCHED = 1, 2, 4, 8


@compiled
def fill_joints(
    q: Vector, velocity: Vector, mass_matrix: Matrix, bias_torque: Vector, joints: Any,
) -> bool:
    """Fill in the joints; return False, nothing changed, where the model gives no numbers."""
    for j in range(joints.shape[0]):
        if not np.isfinite(bias_torque[j]):
            return False
    for j in range(joints.shape[0]):
        joint = joints[j]
        joint.last_velocity, joint.last_bias = joint.velocity, joint.bias_torque
        joint.q = q[j]
        joint.velocity = velocity[j]
        joint.inertia = mass_matrix[j, j]
        joint.bias_torque = bias_torque[j]
    return True


@compiled
def fill_frame(velocity: Vector, jacobian: Matrix, placements: Any, frame: Any) -> None:
    """Fill in pose and twist of the operational frame, and the pose of the sensor."""
    position, rotation, sensor_position, sensor_rotation = placements
    copy_vector(position, frame.position)
    copy_matrix(rotation, frame.rotation)
    copy_vector(sensor_position, frame.sensor_position)
    copy_matrix(sensor_rotation, frame.sensor_rotation)
    for i in range(6):
        total = 0.0
        for j in range(velocity.shape[0]):
            total += jacobian[i, j] * velocity[j]
        frame.twist[i] = total


@compiled
def check_speeds(joints: Any, frame: Any) -> int:
    """Return the sum of OPERATIONAL_SPEED and JOINT_SPEED where the arm is too fast."""
    excess = 0
    for j in range(joints.shape[0]):
        if abs(joints[j].velocity) > joints[j].speed_limit:
            excess = JOINT_SPEED
    speed, turn = 0.0, 0.0
    for k in range(3):
        speed += frame.twist[k] ** 2
        turn += frame.twist[3 + k] ** 2
    if speed > frame.speed_limit ** 2 or turn > frame.turn_limit ** 2:
        excess += OPERATIONAL_SPEED
    return excess


@compiled
def see_arm(
    motion: Matrix, mass_matrix: Matrix, bias_torque: Vector, jacobian: Matrix, placements: Any,
    joints: Any, controls: Any, contacts: Any,
) -> int:
    """
    Take in all that is known of a sample before anything is asked for.

    Parameters
    ----------
    motion
        q [rad] and v [rad/s], shape (2, n).
    mass_matrix, bias_torque, jacobian, placements
        Of the arm there; see `LiveTerms`.
    joints, contacts
        Records of `JOINT`, shape (n,), and `CONTACT`, shape (r,); both changed.
    controls
        One record of `CONTROL` with the wrench in it; its frame is filled in.

    Returns
    -------
    int
        NO_NUMBERS if the model gives none, and nothing has changed; otherwise the sum of
        OPERATIONAL_SPEED, JOINT_SPEED, AMBIGUOUS (the contacts depend on each other, and what
        they bear has not changed) and TOUCHED (by something before the wrist sensor).

    """
    control, velocity = controls[0], motion[1]
    if not fill_joints(motion[0], velocity, mass_matrix, bias_torque, joints):
        return NO_NUMBERS
    fill_frame(velocity, jacobian, placements, control.frame)
    found = check_speeds(joints, control.frame)
    if control.momentum.bandwidth > 0.0:
        if observe_momentum(control, joints, mass_matrix, jacobian):
            found += TOUCHED
        if control.momentum.is_input:
            wrench_of_residual(control, joints, mass_matrix, jacobian)
    if not measure_contacts(control, contacts):
        found += AMBIGUOUS
    return found


class ArmState:
    """
    The arm when its joints were last given, in arrays that the next `update` overwrites.

    Parameters
    ----------
    robot
        Its model.
    controls, contacts
        One record of `CONTROL` and records of `CONTACT`, shape (r,), to be filled in; its own and
        no contacts if not given.

    Attributes
    ----------
    motion
        Joint positions and velocities, shape (2, n), the rows of which are
    q, velocity
        [rad] and [rad/s], shape (n,).
    joints
        Records of `JOINT`, shape (n,).
    frames
        One record of `FRAME`.
    inertia, bias_torque
        Diagonal of M [kg m^2] and C v + g [N m], in `joints`, shape (n,).
    pose, twist_world
        Of the operational frame, in `frames`.
    found
        What is unusual about it; see `see_arm`.

    """

    def __init__(
        self, robot: RobotModel, controls: Any = None, contacts: Any = None,
    ) -> None:
        self.robot = robot
        self._shape = (robot.joint_count,)
        self.motion: Matrix = np.zeros((2, robot.joint_count))
        self.q, self.velocity = self.motion
        self.joints: Any = np.zeros(self._shape, dtype=JOINT)
        self._controls = np.zeros(1, dtype=CONTROL) if controls is None else controls
        self._contacts = np.zeros(0, dtype=CONTACT) if contacts is None else contacts
        self.frames: Any = self._controls['frame']
        for limited, name in ((self.joints, 'speed_limit'), (self.frames, 'speed_limit'),
                              (self.frames, 'turn_limit')):
            limited[name] = np.inf
        self.inertia: Vector = self.joints['inertia']
        self.bias_torque: Vector = self.joints['bias_torque']
        frame = self.frames[0]
        self.pose = Pose(frame['position'], frame['rotation'])
        self.twist_world: Vector = frame['twist']
        terms = robot.compute(self.q, self.velocity)
        compile_for(
            see_arm, self.motion, terms.mass_matrix, terms.bias_torque, terms.jacobian,
            terms.placements, self.joints, self._controls, self._contacts)
        self.look()

    @property
    def finite(self) -> bool:
        """Whether the model gave finite numbers; if not, the arm is where it was before."""
        return self.found != NO_NUMBERS

    def update(self, q: Vector, velocity: Vector) -> bool:
        """
        Take in where the arm is, and what the wrench in `controls` says of the contacts there.

        Parameters
        ----------
        q, velocity
            Joint positions [rad] and velocities [rad/s], shape (n,).

        Returns
        -------
        bool
            Whether the model gives finite numbers there; if not, the arm stays where it was.

        Raises
        ------
        ShapeError
            If an array is not of the robot's size.

        """
        if q.shape != self._shape or velocity.shape != self._shape:
            require_shape('q', q, self._shape)
            require_shape('qd', velocity, self._shape)
        self.q[:] = q  # whatever its layout
        self.velocity[:] = velocity
        return self.refresh()

    def refresh(self) -> bool:
        """Take in what has been written into `motion`; see `update`."""
        self.robot.compute(self.q, self.velocity)
        return self.look()

    def look(self) -> bool:
        """Take in what the robot's model has computed; see `update`."""
        terms = self.robot.terms
        self.found = see_arm(
            self.motion, terms.mass_matrix, terms.bias_torque, terms.jacobian,
            terms.placements, self.joints, self._controls, self._contacts)
        return self.found != NO_NUMBERS
