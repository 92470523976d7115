"""The control law around its compiled core: from joint state, wrench and R to torque."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

from multicontact_control.arrays import Mask, Matrix, require_shape, Vector
from multicontact_control.config import ControllerConfig
from multicontact_control.contact.geometry import MAX_CONTACTS, operational_stiffness
from multicontact_control.control.arm_state import ArmState
from multicontact_control.control.law import control_law, OK, SINGULAR
from multicontact_control.control.reference import Reference, ReferenceSource
from multicontact_control.control.tick import ControlOutput, Measurement
from multicontact_control.control.wrench import measure_contacts, tool_record
from multicontact_control.dynamics.operational_space import MAX_CONDITION, task_inertia
from multicontact_control.dynamics.pose import Pose
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.errors import (
    ConfigError,
    ContactGeometryError,
    SingularTaskError,
)
from multicontact_control.force.observer import (
    continue_from,
    design_observer,
    make_observers,
    ObserverDesign,
)
from multicontact_control.force.plant_model import design_force_loop
from multicontact_control.records import CONTACT, LAW, Records, TASK
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
    arm
        Where the arm is.
    contacts
        Records of `CONTACT`, shape (r,), which every step overwrites.
    active
        Which of them are force controlled, in these records, shape (r,).
    tasks
        One record of `TASK`: what the motion law is asked for.
    wrench_sensor
        The newest reading, shape (6,) [N, N m].

    Raises
    ------
    ConfigError
        If there are more contacts than one wrist sensor can tell apart.

    """

    def __init__(
        self, config: ControllerConfig, robot: RobotModel, reference: ReferenceSource,
    ) -> None:
        count = len(config.contact_names)
        if count > MAX_CONTACTS:
            raise ConfigError('contact_names', f'at most {MAX_CONTACTS} contacts, as many as a '
                              'wrench has components', count)
        self.robot = robot
        self._reference = reference
        self.arm = ArmState(robot)
        self.contacts: Any = np.zeros(count, dtype=CONTACT)
        self.tasks: Any = np.zeros(1, dtype=TASK)
        self.tasks['rotation'] = np.eye(3)
        self.active: Mask = self.contacts['active']
        self._alpha_meas: Vector = self.contacts['alpha_meas']
        self._noise_variance: Vector = self.contacts['noise_variance']
        self._torque: Vector = self.arm.joints['torque']
        # numpy copies a structured array field by field, which takes five times as long.
        self._contact_bytes = self.contacts.view(np.uint8)
        self.wrench_sensor = np.zeros(6)
        self._adopt(config)
        self.reset()
        self._warm_up()

    def _adopt(self, config: ControllerConfig) -> None:
        """Set everything that follows from the configuration alone."""
        self.config = config
        self._laws = law_record(config)
        self._tools = tool_record(config.tool, np.array(config.robot.gravity_world))
        contacts = [config.contacts[name] for name in config.contact_names]
        self.contacts['normal'] = [contact.normal_world for contact in contacts]
        self.contacts['point'] = [contact.point_operational for contact in contacts]
        joints = self.arm.joints
        for name in ('coulomb', 'viscous'):
            joints[name] = getattr(config.friction, name) or 0.0
        joints['torque_limit'] = config.torque_limit or np.inf

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

    def redesign(self, config: ControllerConfig) -> Records | None:
        """
        Return observers for other gains, which keep what they know if its size stays.

        Parameters
        ----------
        config
            Everything tunable, for the same arm, contacts and rate.

        Returns
        -------
        Records or None
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
        observers = make_observers(design_observers(config, self._rotation_world))
        continue_from(observers, self._observers)
        return observers

    def reconfigure(self, config: ControllerConfig) -> None:
        """
        Go on with other gains from the next sample on; see `redesign`.

        If that raises, everything is as it was.
        """
        observers = self.redesign(config)
        self._adopt(config)
        if observers is not None:
            self._observers: Any = observers

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
        self.arm.update(measurement.q, measurement.qd)
        return self.answer(measurement.time, measurement.wrench_sensor, noise_variance)

    def answer(
        self, time: float, wrench_sensor: Vector, noise_variance: Vector,
    ) -> ControlOutput:
        """
        Answer the sample whose joints `arm` has been given: the second half of `step`.

        Parameters
        ----------
        time, wrench_sensor
            See `Measurement`.
        noise_variance
            As for `step`, which also says what is raised.

        """
        if not self.arm.finite:
            raise SingularTaskError(
                "the arm's dynamics: expected finite numbers, found others at joint positions "
                f'{self.arm.q.tolist()} and velocities {self.arm.velocity.tolist()}')
        if wrench_sensor.shape != (6,) or noise_variance.shape != self.active.shape:
            require_shape('wrench_sensor', wrench_sensor, (6,))
            require_shape('noise_variance', noise_variance, self.active.shape)
        self.wrench_sensor[:] = wrench_sensor
        self._noise_variance[:] = noise_variance
        self._measure()
        pose = Pose(self.arm.pose.position_world.copy(), self.arm.pose.rotation_world.copy())
        if not self._started:
            self._start(pose)
        reference = self._reference.update(time, self._alpha_meas)
        self._take_reference(reference)
        self._decide()
        return ControlOutput(
            self._torque.copy(), np.frombuffer(self._contact_bytes.tobytes(), dtype=CONTACT),
            pose, reference.pose_des)

    def _measure(self) -> None:
        """Fill in N and the measured contact forces."""
        if not measure_contacts(
                self.wrench_sensor, self.arm.frames, self._tools, self.contacts):
            raise self._dependent_contacts()

    def _start(self, pose: Pose) -> None:
        """Begin with the first sample."""
        self._rotation_world = pose.rotation_world
        self._observers = make_observers(design_observers(self.config, pose.rotation_world))
        self._reference.start(pose, self.contacts['normal'].copy())
        self._started = True

    def _take_reference(self, reference: Reference) -> None:
        """Copy what is to be done, unless it has been made in these very arrays."""
        if reference.alpha_des.base is self.contacts:
            return
        task, contacts = self.tasks, self.contacts
        task['position'], task['rotation'] = reference.pose_des
        task['twist'], task['acceleration'] = reference.twist_des, reference.acceleration_des
        contacts['active'], contacts['alpha_des'] = reference.active, reference.alpha_des

    def _decide(self) -> None:
        """Work out the joint torque."""
        terms, arm = self.robot.terms, self.arm
        status = control_law(
            self._laws, arm.joints, arm.frames, terms.mass_matrix, terms.jacobian,
            terms.jacobian_rate, self.contacts, self._observers, self.tasks)
        if status == SINGULAR:
            state = self.robot.update(arm.q, arm.velocity)
            task_inertia(state.mass_matrix, state.jacobian)  # says what is wrong
            raise SingularTaskError('J M^-1 J^T: expected a positive definite matrix')
        if status != OK:
            raise self._dependent_contacts()

    def _dependent_contacts(self) -> ContactGeometryError:
        return ContactGeometryError(
            'N: expected independent columns, found normals and contact points of '
            f'{", ".join(self.config.contact_names)} that depend on each other')

    def _warm_up(self) -> None:
        """Call everything compiled once: no step is to wait for it."""
        pose = Pose(self.arm.pose.position_world.copy(), self.arm.pose.rotation_world.copy())
        pose.quaternion_xyzw  # noqa: B018 - compiled too
        self._observers = make_observers(design_observers(self.config, pose.rotation_world))
        for warm in (self._measure, self._decide):
            with contextlib.suppress(SingularTaskError, ContactGeometryError):
                warm()  # all joints at 0 need not be a good posture


def law_record(config: ControllerConfig) -> Records:
    """Return gains and options of the control law as one record of `LAW`."""
    motion, force = config.motion, config.force
    frequency = motion.natural_frequency
    law = np.zeros(1, dtype=LAW)
    law['k_p'] = frequency ** 2
    law['k_v'] = 2.0 * motion.damping_ratio * frequency
    law['K_2'] = force.damping_rate
    law['friction_speed'] = config.friction.speed
    law['nullspace_damping'] = config.nullspace_damping
    law['max_condition'] = MAX_CONDITION
    law['singular_mobility'] = config.limits.singular_mobility
    law['inertia_metric'] = force.projection == 'inertia'
    law['decoupled'] = force.allocation == 'decoupled'
    return law


def design_observers(config: ControllerConfig, rotation_world: Matrix) -> list[ObserverDesign]:
    """
    Design one AOB per contact.

    Parameters
    ----------
    config
        Contacts, force loops.
    rotation_world
        Axes of the operational frame, for which `paper` allocation has its stiffness, shape
        (3, 3).

    """
    force = config.force
    designs = []
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
        designs.append(design_observer(
            loop, order=force.active_state_order, process_noise=force.process_noise,
            initial_covariance=force.initial_covariance))
    return designs
