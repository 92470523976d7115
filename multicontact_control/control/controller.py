"""The composed control law: from joint state, wrist wrench and noise variance to torque."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multicontact_control.arrays import Mask, Matrix, require_shape, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.geometry import (
    contact_coordinates,
    contact_normals,
    operational_stiffness,
)
from multicontact_control.contact.projections import (
    allocate_force,
    contact_rates,
    euclidean_projections,
    inertia_projections,
    Projections,
)
from multicontact_control.control.motion import motion_acceleration
from multicontact_control.control.reference import Reference, ReferenceSource
from multicontact_control.control.wrench import contact_wrench
from multicontact_control.dynamics.operational_space import (
    joint_torque,
    operational_space,
    OperationalSpace,
)
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel, RobotState
from multicontact_control.errors import ConfigError
from multicontact_control.force.active_observer import ActiveObserver
from multicontact_control.force.plant_model import design_force_loop


@dataclass(frozen=True, slots=True)
class Measurement:
    """
    One sample of the sensors.

    Attributes
    ----------
    time
        Time since the first sample [s].
    q, qd
        Joint positions [rad] and velocities [rad/s], shape (n,).
    wrench_sensor
        Reading of the wrist sensor in its frame, force first, shape (6,) [N, N m].
    effort
        Measured joint torque, shape (n,) [N m]; only the first one counts, to start from.

    """

    time: float
    q: Vector
    qd: Vector
    wrench_sensor: Vector
    effort: Vector | None = None


@dataclass(frozen=True, slots=True)
class ControlOutput:
    """
    The answer to one sample.

    Attributes
    ----------
    torque
        Gamma, shape (n,) [N m].
    alpha_meas, alpha_est, alpha_rate_est, alpha_des
        Contact forces [N] and rate [N/s], shape (r,); estimates and desired are 0 where no
        force is controlled.
    active
        Which contacts are force controlled, shape (r,).
    pose, pose_des
        Present and desired pose of the operational frame.

    """

    torque: Vector
    alpha_meas: Vector
    alpha_est: Vector
    alpha_rate_est: Vector
    alpha_des: Vector
    active: Mask
    pose: Pose
    pose_des: Pose


class Controller:
    """
    Multi-contact compliant motion control of one arm (P04 sec. 3-4).

    F = Lambda (Omega_m f_t* + Omega_f f_c*) + mu + p + f_c_hat, Gamma = J^T F (eqs 24-26).

    Parameters
    ----------
    config
        Everything tunable.
    robot
        The arm.
    reference
        What to do.

    """

    def __init__(
        self, config: ControllerConfig, robot: RobotModel, reference: ReferenceSource,
    ) -> None:
        self.robot = robot
        self._reference = reference
        self._adopt(config)
        self.reset()

    def _adopt(self, config: ControllerConfig) -> None:
        """Set everything that follows from the configuration alone."""
        self.config = config
        contacts = [config.contacts[name] for name in config.contact_names]
        self._normals_world = np.array([contact.normal_world for contact in contacts])
        self._points_operational = np.array([contact.point_operational for contact in contacts])
        self._gravity_world = np.array(config.robot.gravity_world)
        self._torque_limit = np.array(config.torque_limit) if config.torque_limit else np.full(
            self.robot.joint_count, np.inf)
        none = np.zeros(self.robot.joint_count)
        self._coulomb = np.array(config.friction.coulomb) if config.friction.coulomb else none
        self._viscous = np.array(config.friction.viscous) if config.friction.viscous else none

    @classmethod
    def from_config(
        cls, config: ControllerConfig, reference: ReferenceSource, base_dir: Path,
    ) -> Controller:
        """
        Build a controller with the arm its configuration names.

        Raises
        ------
        ConfigError
            If the URDF cannot be read or does not match the names.

        """
        return cls(config, RobotModel(config.robot, base_dir), reference)

    def reset(self) -> None:
        """Forget everything measured; the next sample starts anew."""
        self._observers: list[ActiveObserver] = []
        self._active: Mask = np.zeros(len(self.config.contact_names), dtype=bool)

    def redesign(self, config: ControllerConfig) -> list[ActiveObserver]:
        """
        Return observers for other gains, which keep what they know where its size stays.

        Parameters
        ----------
        config
            Everything tunable, for the same arm, contacts and rate.

        Raises
        ------
        ConfigError
            If that is not so, or there is no such design.

        """
        for name in ('rate', 'robot', 'contact_names'):
            if getattr(config, name) != getattr(self.config, name):
                raise ConfigError(name, f'{getattr(self.config, name)} while in use',
                                  getattr(config, name))
        if not self._observers:
            return []
        observers = self._design_observers(self._levers, config)
        for new, old in zip(observers, self._observers):
            new.continue_from(old)
        return observers

    def reconfigure(self, config: ControllerConfig) -> None:
        """
        Go on with other gains from the next sample on; see `redesign`.

        If that raises, everything is as it was.
        """
        self._observers = self.redesign(config)
        self._adopt(config)

    def step(self, measurement: Measurement, noise_variance: Vector) -> ControlOutput:
        """
        Answer one sample.

        Parameters
        ----------
        measurement
            The sample.
        noise_variance
            R_k per contact, estimated from the samples up to the one before, shape (r,) [N^2].

        Returns
        -------
        ControlOutput
            Torque and what led to it.

        Raises
        ------
        ShapeError
            If an array is not of the robot's or the contacts' size.
        SingularTaskError
            If the arm is in a singular posture.
        ContactGeometryError
            If the contacts' normals are not independent.

        """
        require_shape('noise_variance', noise_variance, self._active.shape)
        state = self.robot.update(measurement.q, measurement.qd)
        levers = -self._points_operational @ state.pose.rotation_world.T
        N_all = contact_normals(self._normals_world, levers)
        wrench = contact_wrench(
            measurement.wrench_sensor, state.sensor_pose, state.pose.position_world,
            self.config.tool, self._gravity_world)
        alpha_meas = contact_coordinates(N_all, wrench)
        if not self._observers:
            self._levers = levers
            self._observers = self._design_observers(levers, self.config)
            self._reference.start(state.pose, self._normals_world)
        reference = self._reference.update(measurement.time, alpha_meas)
        self._follow_active_set(reference.active, alpha_meas)
        space = operational_space(state)
        N = N_all[:, self._active]
        acceleration = self._acceleration(
            state, space, reference, N, self._force_inputs(reference, alpha_meas, noise_variance))
        alpha_est = self._estimates(0)
        force = (space.Lambda @ acceleration + space.mu + space.p + N @ alpha_est[self._active])
        torque = joint_torque(
            force, state, space, nullspace_damping=self.config.nullspace_damping)
        torque += self._friction(measurement.qd)
        return ControlOutput(
            torque=np.clip(torque, -self._torque_limit, self._torque_limit),
            alpha_meas=alpha_meas, alpha_est=alpha_est, alpha_rate_est=self._estimates(1),
            alpha_des=reference.alpha_des.copy(), active=self._active.copy(), pose=state.pose,
            pose_des=reference.pose_des)

    def _friction(self, qd: Vector) -> Vector:
        """Return the torque that the joints' friction is expected to take, shape (n,) [N m]."""
        friction: Vector = self._coulomb * np.tanh(qd / self.config.friction.speed)
        return friction + self._viscous * qd

    @staticmethod
    def _design_observers(levers: Matrix, config: ControllerConfig) -> list[ActiveObserver]:
        """Design one AOB per contact for the geometry of the first sample."""
        force = config.force
        observers = []
        for name, lever in zip(config.contact_names, levers):
            k_env = config.contacts[name].stiffness
            # `decoupled` drives the contact point itself, `paper` the coordinate along N_i.
            stiffness = k_env if force.allocation == 'decoupled' else operational_stiffness(
                k_env, np.array(config.contacts[name].normal_world), lever)
            loop = design_force_loop(
                stiffness, damping_rate=force.damping_rate, input_delay=config.loop_delay,
                period=config.period, time_constant=force.time_constant,
                second_pole_ratio=force.second_pole_ratio)
            observers.append(ActiveObserver(
                loop, order=force.active_state_order, process_noise=force.process_noise,
                initial_covariance=force.initial_covariance))
        return observers

    def _follow_active_set(self, active: Mask, alpha_meas: Vector) -> None:
        """Start the observer of every contact that has just become force controlled."""
        for i in np.flatnonzero(active & ~self._active):
            self._observers[i].reset(float(alpha_meas[i]))
        self._active = active.copy()

    def _force_inputs(
        self, reference: Reference, alpha_meas: Vector, noise_variance: Vector,
    ) -> Vector:
        """Return u of every active contact (P04 eq. 36)."""
        inputs = []
        for i in np.flatnonzero(self._active):
            observer = self._observers[i]
            observer.update(float(alpha_meas[i]), float(noise_variance[i]))
            inputs.append(observer.command(float(reference.alpha_des[i])))
        return np.array(inputs)

    def _acceleration(
        self, state: RobotState, space: OperationalSpace, reference: Reference, N: Matrix,
        inputs: Vector,
    ) -> Vector:
        """Return Omega_m f_t* + Omega_f f_c* (P04 eq. 27)."""
        force = self.config.force
        projections = self._projections(N, space)
        f_t = motion_acceleration(self.config.motion, reference, state.pose, state.twist_world)
        rates = contact_rates(N, state.twist_world, force.allocation)
        alpha_star = inputs - force.damping_rate * rates
        f_c = allocate_force(N, alpha_star, force.allocation)
        acceleration: Vector = projections.Omega_m @ f_t + projections.Omega_c @ f_c
        return acceleration

    def _projections(self, N: Matrix, space: OperationalSpace) -> Projections:
        if self.config.force.projection == 'inertia':
            return inertia_projections(N, space.Lambda)
        return euclidean_projections(N)

    def _estimates(self, derivative: int) -> Vector:
        """Return alpha (0) or its rate (1) as the observers of the active contacts see it."""
        return np.array([
            observer.x_est[derivative] if active else 0.0
            for observer, active in zip(self._observers, self._active)])
