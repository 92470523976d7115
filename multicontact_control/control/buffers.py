"""The arrays a controller gives to compiled code: constants, and copies of its inputs."""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Mask, Matrix, require_shape, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.control.kernels import POSITION
from multicontact_control.control.reference import Reference
from multicontact_control.dynamics.operational_space import MAX_CONDITION
import numpy as np


@dataclass(frozen=True, slots=True)
class Constants:
    """
    A controller's configuration as arrays, see `control_law` and `measure_contacts`.

    Attributes
    ----------
    normals_world, points_operational
        Contact normals and points, shape (r, 3).
    measured
        Which contacts share the measured wrench: all, shape (r,).
    tool, gains, joints
        Rows and entries as the constants of `kernels` name them.
    inertia_metric, decoupled
        Projection and allocation.

    """

    normals_world: Matrix
    points_operational: Matrix
    measured: Mask
    tool: Matrix
    gains: Vector
    joints: Matrix
    inertia_metric: bool
    decoupled: bool


def constants_of(config: ControllerConfig, joints: int) -> Constants:
    """Return the arrays of a configuration for an arm with that many joints."""
    contacts = [config.contacts[name] for name in config.contact_names]
    motion, force, friction = config.motion, config.force, config.friction
    frequency = motion.natural_frequency
    weight = config.tool.mass * np.array(config.robot.gravity_world)
    return Constants(
        normals_world=np.array([contact.normal_world for contact in contacts]),
        points_operational=np.array([contact.point_operational for contact in contacts]),
        measured=np.ones(len(contacts), dtype=bool),
        tool=np.stack([np.array(config.tool.com_sensor), weight,
                       *np.reshape(config.tool.bias_sensor, (2, 3))]),
        gains=np.array([
            frequency ** 2, 2.0 * motion.damping_ratio * frequency, force.damping_rate,
            friction.speed, config.nullspace_damping, MAX_CONDITION,
            config.limits.singular_mobility]),
        joints=np.stack([
            np.array(friction.coulomb or np.zeros(joints), dtype=float),
            np.array(friction.viscous or np.zeros(joints), dtype=float),
            np.array(config.torque_limit or np.full(joints, np.inf), dtype=float)]),
        inertia_metric=force.projection == 'inertia', decoupled=force.allocation == 'decoupled')


class Buffers:
    """
    Copies of what comes from outside, always of the same type and layout.

    numba compiles anew for every other type: a strided or read-only array from a message would
    cost seconds in the middle of a run.

    Parameters
    ----------
    joints, contacts
        n and r.

    """

    def __init__(self, joints: int, contacts: int) -> None:
        self.q, self.qd = np.zeros(joints), np.zeros(joints)
        self.wrench_sensor = np.zeros(6)
        self.noise_variance, self.alpha_des = np.ones(contacts), np.zeros(contacts)
        self.active: Mask = np.zeros(contacts, dtype=bool)
        self.pose_des, self.motion_des = np.eye(4, 3), np.zeros((2, 6))
        self._rotation_des, self._position_des = self.pose_des[:3], self.pose_des[POSITION]
        self._twist_des, self._acceleration_des = self.motion_des
        self._joints, self._contacts = (joints,), (contacts,)
        self.normal_rows = np.zeros((contacts, 6))

    def take_joints(self, q: Vector, qd: Vector) -> None:
        """
        Copy where the arm is.

        Raises
        ------
        ShapeError
            If an array is not of the robot's size.

        """
        if q.shape != self._joints or qd.shape != self._joints:
            require_shape('q', q, self._joints)
            require_shape('qd', qd, self._joints)
        self.q[:] = q
        self.qd[:] = qd

    def take_wrench(self, wrench_sensor: Vector, noise_variance: Vector) -> None:
        """
        Copy the rest of a sample.

        Raises
        ------
        ShapeError
            If an array is not of its size.

        """
        if wrench_sensor.shape != (6,) or noise_variance.shape != self._contacts:
            require_shape('wrench_sensor', wrench_sensor, (6,))
            require_shape('noise_variance', noise_variance, self._contacts)
        self.wrench_sensor[:] = wrench_sensor
        self.noise_variance[:] = noise_variance

    def take_reference(self, reference: Reference) -> None:
        """Copy what is to be done, unless it has been made in these very arrays."""
        if reference.active is self.active:
            return
        pose = reference.pose_des
        self._position_des[:] = pose.position_world
        self._rotation_des[:] = pose.rotation_world
        self._twist_des[:] = reference.twist_des
        self._acceleration_des[:] = reference.acceleration_des
        self.active[:] = reference.active
        self.alpha_des[:] = reference.alpha_des
