"""
The composed control law: from joint state, wrist wrench and noise variance to torque.

The arithmetic is in `kernels`, compiled; here is what surrounds it.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.geometry import MAX_CONTACTS, operational_stiffness
from multicontact_control.control.buffers import Buffers, constants_of
from multicontact_control.control.kernels import control_law, measure_contacts, OK, SINGULAR
from multicontact_control.control.reference import ReferenceSource
from multicontact_control.control.tick import ControlOutput, Measurement
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
from multicontact_control.force.kernels import MEASURED, REPORT_ROWS
from multicontact_control.force.observer_bank import ObserverBank
from multicontact_control.force.plant_model import design_force_loop
import numpy as np

__all__ = ['Controller', 'ControlOutput', 'Measurement']


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

    Attributes
    ----------
    buffers
        What compiled code works on.

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
        self._joints, contacts = robot.joint_count, len(config.contact_names)
        self._report_shape = len(REPORT_ROWS), contacts
        self.buffers = Buffers(self._joints, contacts)
        self._adopt(config)
        self.reset()
        self._warm_up()

    def _adopt(self, config: ControllerConfig) -> None:
        """Set everything that follows from the configuration alone."""
        self.config = config
        self._constants = constants_of(config, self._joints)
        self._measure_arguments = self._gather_measure_arguments()

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
        self._started = False

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
        if not self._started:
            return None
        observers = self._design_observers(self._rotation_world, config)
        observers.continue_from(self._observers)
        return observers

    def reconfigure(self, config: ControllerConfig) -> None:
        """
        Go on with other gains from the next sample on; see `redesign`.

        If that raises, everything is as it was.
        """
        observers = self.redesign(config)
        self._adopt(config)
        if observers is not None:
            self._observers = observers
            self._law_arguments = self._gather_law_arguments(observers)

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
        self.sense(measurement.q, measurement.qd)
        return self.answer(measurement.time, measurement.wrench_sensor, noise_variance)

    def sense(self, q: Vector, qd: Vector) -> LiveTerms:
        """
        Take in where the arm is: the first half of `step`.

        Parameters
        ----------
        q, qd
            Joint positions [rad] and velocities [rad/s], shape (n,).

        Returns
        -------
        LiveTerms
            The arm's terms there, for who needs them too.

        Raises
        ------
        ShapeError
            If an array is not of the robot's size.

        """
        buffers = self.buffers
        buffers.take_joints(q, qd)
        return self.robot.compute(buffers.q, buffers.qd)

    def answer(
        self, time: float, wrench_sensor: Vector, noise_variance: Vector,
    ) -> ControlOutput:
        """
        Answer the sample whose joints have been sensed: the second half of `step`.

        Parameters
        ----------
        time, wrench_sensor
            See `Measurement`.
        noise_variance
            As for `step`, which also says what is raised.

        """
        buffers, terms = self.buffers, self.robot.terms
        buffers.take_wrench(wrench_sensor, noise_variance)
        report = np.empty(self._report_shape)
        self._measure(report)
        pose = Pose(terms.position_world.copy(), terms.rotation_world.copy())
        if not self._started:
            self._start(pose)
        reference = self._reference.update(time, report[MEASURED])
        buffers.take_reference(reference)
        torque = self._decide(terms, report)
        return ControlOutput(
            torque, report, buffers.active.copy(), pose, reference.pose_des)

    def _measure(self, report: Matrix) -> None:
        """Fill in the measured contact forces; N is in the buffers then."""
        if not measure_contacts(report, *self._measure_arguments):
            raise self._dependent_contacts()

    def _start(self, pose: Pose) -> None:
        """Begin with the first sample."""
        self._rotation_world = pose.rotation_world
        self._observers = self._design_observers(pose.rotation_world, self.config)
        self._law_arguments = self._gather_law_arguments(self._observers)
        self._reference.start(pose, self._constants.normals_world)
        self._started = True

    def _decide(self, terms: LiveTerms, report: Matrix) -> Vector:
        """Return the joint torque; the report is complete then."""
        torque = np.empty(self._joints)
        status = control_law(
            report, torque, terms.jacobian, terms.jacobian_rate, *self._law_arguments)
        if status == OK:
            return torque
        if status == SINGULAR:
            state = self.robot.update(self.buffers.q, self.buffers.qd)
            task_inertia(state.mass_matrix, state.jacobian)  # says what is wrong
            raise SingularTaskError('J M^-1 J^T: expected a positive definite matrix')
        raise self._dependent_contacts()

    def _gather_measure_arguments(self) -> tuple[Any, ...]:
        """Return what `measure_contacts` takes that stays where it is from tick to tick."""
        terms, constants, buffers = self.robot.terms, self._constants, self.buffers
        return (
            buffers.wrench_sensor, terms.sensor_rotation_world, terms.sensor_position_world,
            terms.rotation_world, terms.position_world, constants.tool, constants.normals_world,
            constants.points_operational, constants.measured, buffers.normal_rows)

    def _gather_law_arguments(self, observers: ObserverBank) -> tuple[Any, ...]:
        """Return what `control_law` takes that stays where it is from tick to tick."""
        terms, constants, buffers = self.robot.terms, self._constants, self.buffers
        return (
            terms.mass_matrix, terms.bias_torque, buffers.qd, terms.position_world,
            terms.rotation_world, buffers.pose_des, buffers.motion_des, buffers.normal_rows,
            buffers.active, buffers.alpha_des, buffers.noise_variance, constants.gains,
            constants.inertia_metric, constants.decoupled, constants.joints,
            observers.matrices, observers.vectors, observers.scalars, observers.P_0)

    def _dependent_contacts(self) -> MulticontactError:
        if not np.isfinite(self.buffers.q).all():
            return SingularTaskError(
                f'joint positions: expected finite numbers, found {self.buffers.q.tolist()}')
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
        terms = self.robot.compute(self.buffers.q, self.buffers.qd)
        pose = Pose(terms.position_world.copy(), terms.rotation_world.copy())
        pose.quaternion_xyzw  # noqa: B018 - compiled too
        self._law_arguments = self._gather_law_arguments(
            self._design_observers(pose.rotation_world, self.config))
        report = np.zeros(self._report_shape)
        for warm in (lambda: self._measure(report), lambda: self._decide(terms, report)):
            with contextlib.suppress(SingularTaskError, ContactGeometryError):
                warm()  # nobody has said that all joints at 0 is a good posture
