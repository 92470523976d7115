"""
The composed control law: from joint state, wrist wrench and noise variance to torque.

The arithmetic is in `kernels`, compiled; here is what surrounds it.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.geometry import MAX_CONTACTS, operational_stiffness
from multicontact_control.control.buffers import Buffers, constants_of
from multicontact_control.control.kernels import control_law, measure_contacts, OK, SINGULAR
from multicontact_control.control.reference import ReferenceSource
from multicontact_control.dynamics.operational_space import task_inertia
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import LiveTerms, RobotModel
from multicontact_control.errors import (
    ConfigError,
    ContactGeometryError,
    MulticontactError,
    SingularTaskError,
)
from multicontact_control.force.active_observer import ActiveObserver
from multicontact_control.force.observer_bank import ObserverBank
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
    innovation, prior_variance, variance_used
        What each observer found in this sample: alpha_meas minus its prediction [N], the
        variance C P_1 C^T of that prediction and the R it worked with [N^2], shape (r,). All 0
        where no force is controlled, and for the sample with which control starts.
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
    innovation: Vector
    prior_variance: Vector
    variance_used: Vector
    active: Mask
    pose: Pose
    pose_des: Pose


class Controller:
    """
    Multi-contact compliant motion control of one arm (P04 sec. 3-4).

    F = Lambda (Omega_m f_t* + Omega_f f_c*) + mu + p + f_c_hat, Gamma = J^T F (eqs 24-26).

    Everything is compiled when a controller is made; no step waits for it.

    Parameters
    ----------
    config
        Everything tunable.
    robot
        The arm.
    reference
        What to do.

    Raises
    ------
    ConfigError
        If there are more contacts than one wrist sensor can tell apart.

    """

    def __init__(
        self, config: ControllerConfig, robot: RobotModel, reference: ReferenceSource,
    ) -> None:
        if len(config.contact_names) > MAX_CONTACTS:
            raise ConfigError('contact_names', f'at most {MAX_CONTACTS} contacts, as many as a '
                              'wrench has components', len(config.contact_names))
        self.robot = robot
        self._reference = reference
        self._joints, self._contacts = robot.joint_count, len(config.contact_names)
        self._adopt(config)
        self._buffers = Buffers(self._joints, self._contacts)
        self.reset()
        self._warm_up()

    def _adopt(self, config: ControllerConfig) -> None:
        """Set everything that follows from the configuration alone."""
        self.config = config
        self._constants = constants_of(config, self._joints)

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
        self._observers: ObserverBank | None = None

    def redesign(self, config: ControllerConfig) -> ObserverBank | None:
        """
        Return observers for other gains, which keep what they know if its size stays.

        Parameters
        ----------
        config
            Everything tunable, for the same arm, contacts and rate.

        Returns
        -------
        ObserverBank or None
            The observers, None before the first sample.

        Raises
        ------
        ConfigError
            If that is not so, or there is no such design.

        """
        for name in ('rate', 'robot', 'contact_names'):
            if getattr(config, name) != getattr(self.config, name):
                raise ConfigError(name, f'{getattr(self.config, name)} while in use',
                                  getattr(config, name))
        if self._observers is None:
            return None
        observers = self._design_observers(self._rotation_world, config)
        observers.continue_from(self._observers)
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
        buffers = self._buffers
        buffers.take_sample(
            measurement.q, measurement.qd, measurement.wrench_sensor, noise_variance)
        terms = self.robot.compute(buffers.q, buffers.qd)
        alpha_meas = self._measure(terms)
        pose = Pose(terms.position_world.copy(), terms.rotation_world.copy())
        observers = self._observers
        if observers is None:
            self._rotation_world = pose.rotation_world
            observers = self._observers = self._design_observers(
                pose.rotation_world, self.config)
            self._reference.start(pose, self._constants.normals_world)
        reference = self._reference.update(measurement.time, alpha_meas)
        buffers.take_reference(reference)
        torque, report = self._decide(terms, observers, alpha_meas)
        alpha_est, alpha_rate_est, innovation, prior_variance, variance_used = report
        return ControlOutput(
            torque, alpha_meas, alpha_est, alpha_rate_est, buffers.alpha_des.copy(),
            innovation, prior_variance, variance_used, buffers.active.copy(), pose,
            reference.pose_des)

    def _measure(self, terms: LiveTerms) -> Vector:
        """Return the measured contact forces; N is in the buffers then."""
        constants, buffers = self._constants, self._buffers
        alpha_meas = np.empty(self._contacts)
        if not measure_contacts(
                buffers.wrench_sensor, terms.sensor_rotation_world, terms.sensor_position_world,
                terms.rotation_world, terms.position_world, constants.tool,
                constants.normals_world, constants.points_operational, constants.measured,
                buffers.normal_rows, alpha_meas):
            raise self._dependent_contacts()
        return alpha_meas

    def _decide(
        self, terms: LiveTerms, observers: ObserverBank, alpha_meas: Vector,
    ) -> tuple[Vector, Matrix]:
        """Return the joint torque and what the observers report."""
        constants, buffers = self._constants, self._buffers
        torque, report = np.empty(self._joints), np.empty((5, self._contacts))
        status = control_law(
            terms.mass_matrix, terms.bias_torque, terms.jacobian, terms.jacobian_rate, buffers.qd,
            terms.position_world, terms.rotation_world, buffers.position_des,
            buffers.rotation_des, buffers.twist_des, buffers.acceleration_des,
            buffers.normal_rows, buffers.active, alpha_meas, buffers.alpha_des,
            buffers.noise_variance, constants.gains, constants.inertia_metric,
            constants.decoupled, constants.joints, *observers.arrays, report, torque)
        if status == OK:
            return torque, report
        if status == SINGULAR:
            state = self.robot.update(buffers.q, buffers.qd)
            task_inertia(state.mass_matrix, state.jacobian)  # says what is wrong
            raise SingularTaskError('J M^-1 J^T: expected a positive definite matrix')
        raise self._dependent_contacts()

    def _dependent_contacts(self) -> MulticontactError:
        if not np.isfinite(self._buffers.q).all():
            return SingularTaskError(
                f'joint positions: expected finite numbers, found {self._buffers.q.tolist()}')
        return ContactGeometryError(
            'N: expected independent columns, found normals and contact points of '
            f'{", ".join(self.config.contact_names)} that depend on each other')

    @staticmethod
    def _design_observers(rotation_world: Matrix, config: ControllerConfig) -> ObserverBank:
        """Design one AOB per contact for the geometry of the first sample."""
        force = config.force
        observers = []
        for name in config.contact_names:
            contact = config.contacts[name]
            k_env = contact.stiffness
            # `decoupled` drives the contact point itself, `paper` the coordinate along N_i.
            stiffness = k_env if force.allocation == 'decoupled' else operational_stiffness(
                k_env, np.array(contact.normal_world),
                -rotation_world @ np.array(contact.point_operational))
            loop = design_force_loop(
                stiffness, damping_rate=force.damping_rate, input_delay=config.loop_delay,
                period=config.period, time_constant=force.time_constant,
                second_pole_ratio=force.second_pole_ratio)
            observers.append(ActiveObserver(
                loop, order=force.active_state_order, process_noise=force.process_noise,
                initial_covariance=force.initial_covariance))
        return ObserverBank(observers, force.initial_covariance)

    def _warm_up(self) -> None:
        """Call everything compiled once with arrays of the types it will see."""
        buffers = self._buffers
        terms = self.robot.compute(buffers.q, buffers.qd)
        pose = Pose(terms.position_world.copy(), terms.rotation_world.copy())
        pose.quaternion_xyzw  # noqa: B018 - compiled too
        alpha_meas = np.zeros(self._contacts)
        observers = self._design_observers(pose.rotation_world, self.config)
        for warm in (lambda: self._measure(terms),
                     lambda: self._decide(terms, observers, alpha_meas)):
            with contextlib.suppress(SingularTaskError, ContactGeometryError):
                warm()  # nobody has said that all joints at 0 is a good posture
