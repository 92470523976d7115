"""The control law around its compiled core: from joint state, wrench and R to torque."""

from __future__ import annotations

import contextlib
import math
from pathlib import Path
from typing import Any, NoReturn

from multicontact_control.arrays import Mask, Matrix, require_shape, Vector
from multicontact_control.compiled import compile_for
from multicontact_control.config import ControllerConfig, ToolConfig
from multicontact_control.config.contact import FORCE
from multicontact_control.contact.geometry import (
    check_columns,
    friction_coupling,
    operational_stiffness,
)
from multicontact_control.contact.wrench import tool_record
from multicontact_control.control.arm import AMBIGUOUS, ArmState
from multicontact_control.control.law import control_law, DEPENDENT, LIMITED
from multicontact_control.control.tick import ControlOutput
from multicontact_control.dynamics.operational_space import (
    MAX_CONDITION,
    STOP_MARGIN,
    task_inertia,
)
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import (
    ConfigError,
    ContactGeometryError,
    SingularTaskError,
)
from multicontact_control.force.force_law import act_beyond, continue_laws, make_force_laws
from multicontact_control.force.observer import rescale
from multicontact_control.records import CONTACT, CONTROL, LAW, Records
import numpy as np

TASK_SIZE = 6  # joints with which an arm has no null space
STOP_RATIO = 4.0  # frequency by which joints are kept off their stops, over the posture's
SINGULAR_MOBILITY = 0.004  # 1/kg, eigenvalue of J M^-1 J^T up to which Lambda is damped
LEAST_TASK_SHARE = 0.5  # of the task at a torque limit; the rest is cut joint by joint
LARGEST_DRIFT = 0.02  # of a stiffness, from which on an observer is redesigned
LEVERED = 1.05  # N that 1 N of friction is read as, from which on a lever is to blame
NORMAL_TIME = 0.06  # s, in which an estimated normal turns; 0.03 s swings on rough surfaces
SURFACE_SPEED_TIME = 0.05  # s, time constant of an estimated speed of a surface


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
    controls, contacts, laws
        What every step overwrites: one record of `CONTROL`, records of `CONTACT` and, from the
        first sample on, of `FORCE_LAW`, shape (r,).
    active
        Which contacts are force controlled, in these records, shape (r,).
    misread_friction
        From the first sample on, where a lever turns friction into more than itself: a contact
        whose friction is neither expected nor allowed for, the force or couple that it is read
        as, and how much of it 1 N is [N].
    measured
        Where what is measured goes: q and v, shape (2, n), wrench, shape (6,), R, shape (r,), and
        the torques that acted, shape (n,).

    Raises
    ------
    ConfigError
        If one wrist sensor cannot tell the contacts apart.

    """

    def __init__(self, config: ControllerConfig, robot: RobotModel) -> None:
        count = len(config.columns)
        self.robot = robot
        self.controls: Any = np.zeros(1, dtype=CONTROL)
        self.controls['measured'] = True
        self.controls['task']['rotation'] = np.eye(3)
        self.contacts: Any = np.zeros(count, dtype=CONTACT)
        self.arm = ArmState(robot, self.controls, self.contacts)
        self.active: Mask = self.contacts['answer']['active']
        joints = self.arm.joints
        self.measured = (self.arm.motion, self.controls['wrench'][0],
                         self.contacts['noise_variance'], joints['effort'])
        self.torque: Vector = joints['torque']
        # numpy copies a structured array field by field, which takes five times as long.
        self._contact_bytes = self.contacts.view(np.uint8)
        self._control_bytes = self.controls.view(np.uint8)
        self.misread_friction: list[tuple[str, str, float]] = []
        self._adopt(config)
        check_columns(config.column_names, self.contacts)
        self.reset()
        pose = self._pose()
        pose.quaternion_xyzw  # noqa: B018 - no step is to wait for it to be compiled
        self.laws: Any = self._design(config, pose.rotation_world)
        compile_for(
            control_law, self.controls, self.arm.joints, robot.terms.mass_matrix,
            robot.terms.jacobian, robot.terms.jacobian_rate, self.contacts, self.laws)
        with contextlib.suppress(SingularTaskError, ContactGeometryError):
            self.answer()  # all joints at 0 need not be a good posture
        self.reset()

    def _adopt(self, config: ControllerConfig) -> None:
        """Set everything that follows from the configuration alone."""
        before = getattr(self, 'config', None)
        self.config = config
        self.controls['law'] = law_record(config)
        by_momentum = config.wrench_input == 'momentum'  # from which nothing has to be taken off
        self.controls['tool'] = tool_record(
            ToolConfig() if by_momentum else config.tool, np.array(config.robot.gravity_world))
        self.controls['momentum']['is_input'] = by_momentum
        # What has been learnt of the surfaces is kept.
        if before is None or before.contacts != config.contacts:
            place_columns(config, self.contacts)
        joints = self.arm.joints
        for name in ('coulomb', 'viscous'):
            joints[name] = getattr(config.friction, name) or 0.0
        joints['torque_limit'] = config.torque_limit or np.inf
        joints['lower'] = config.limits.joint_lower or -np.inf
        joints['upper'] = config.limits.joint_upper or np.inf
        self._coordinate_driven = config.force.allocation == 'paper'

    @classmethod
    def from_config(
        cls, config: ControllerConfig, base_dir: Path,
    ) -> Controller:
        """
        Build a controller with the arm its configuration names.

        Raises
        ------
        ConfigError
            If the URDF cannot be read or does not match the names.

        """
        return cls(config, RobotModel(config.robot, base_dir))

    @property
    def observers(self) -> Records:
        """Return the active observers of the force laws, records of `OBSERVER`, shape (r,)."""
        observers: Records = self.laws['observer']
        return observers

    @staticmethod
    def _design(config: ControllerConfig, rotation_world: Matrix) -> Records:
        return make_force_laws(config, loop_stiffnesses(config, rotation_world))

    def reset(self) -> None:
        """Forget everything measured; the next sample starts anew."""
        self.started = False
        self.contacts['normal'] = self.contacts['normal_told']
        self.contacts['surface_speed_est'] = 0.0

    def redesign(self, config: ControllerConfig) -> Records | None:
        """
        Return force laws for other gains, which keep what they know as far as that is possible.

        Parameters
        ----------
        config
            Everything tunable, for the same arm, contacts and rate.

        Returns
        -------
        Records or None
            The force laws, None before the first sample.

        Raises
        ------
        ConfigError
            If that is not so, or there is no such design.

        """
        for name in ('rate', 'robot', 'contact_names', 'column_names'):
            if getattr(config, name) != getattr(self.config, name):
                raise ConfigError(name, f'{getattr(self.config, name)} while in use',
                                  getattr(config, name))
        columns = self.contacts.copy()
        place_columns(config, columns)
        check_columns(config.column_names, columns)  # normals may be others
        if not self.started:
            return None
        laws = self._design(config, self.arm.pose.rotation_world)
        continue_laws(laws, self.laws)
        return laws

    def reconfigure(self, config: ControllerConfig) -> None:
        """
        Go on with other gains from the next sample on; see `redesign`.

        If that raises, everything is as it was.
        """
        laws = self.redesign(config)
        self._adopt(config)
        if laws is not None:
            self.laws = laws
            self.misread_friction = self._find_misread_friction()
            self._stiffnesses = loop_stiffnesses(config, self.arm.pose.rotation_world)

    def take(
        self, q: Vector, qd: Vector, wrench_sensor: Vector, noise_variance: Vector | None = None,
    ) -> None:
        """
        Take in a sample that no input stage has written into `measured`, and see it.

        Parameters
        ----------
        q, qd
            Joint positions [rad] and velocities [rad/s], shape (n,).
        wrench_sensor
            Reading of the wrist sensor in its frame, force first, shape (6,) [N, N m].
        noise_variance
            R_k per contact, shape (r,) [N^2]; the one before if not given.

        Raises
        ------
        ShapeError
            If an array is not of the robot's or the contacts' size.

        """
        (own_q, own_qd), wrench, variance, _ = self.measured
        for name, values, place in (
                ('q', q, own_q), ('qd', qd, own_qd), ('wrench_sensor', wrench_sensor, wrench),
                ('noise_variance', noise_variance, variance)):
            if values is not None:
                require_shape(name, values, place.shape)
                place[:] = values
        self.see()

    def see(self) -> bool:
        """
        Work out what is in `measured`: where the arm is, its model there, what the contacts bear.

        Returns
        -------
        bool
            Whether the model gives finite numbers there; if not, the arm stays where it was.

        """
        return self.arm.refresh()

    def start(self) -> Pose:
        """Design the force laws for where the arm is; return the pose that a task starts from."""
        self.require_answer()
        pose = self._pose()
        self._stiffnesses = loop_stiffnesses(self.config, pose.rotation_world)
        self.laws = self._design(self.config, pose.rotation_world)
        joints = self.arm.joints
        joints['posture'] = np.clip(  # what lies beyond a stop would be fought over
            self.config.posture.joints or self.arm.q, joints['lower'] + STOP_MARGIN,
            joints['upper'] - STOP_MARGIN)
        self.misread_friction = self._find_misread_friction()
        self.started = True
        return pose

    def require_answer(self) -> None:
        """
        Raise if what has been seen has no answer.

        Raises
        ------
        SingularTaskError
            If the arm's model gives no finite numbers.
        ContactGeometryError
            If the contacts cannot be told apart in this posture.

        """
        if not self.arm.finite:
            raise SingularTaskError(
                "the arm's dynamics: expected finite numbers, found others at joint positions "
                f'{self.arm.q.tolist()} and velocities {self.arm.velocity.tolist()}')
        if self.arm.found & AMBIGUOUS:
            self._refuse(DEPENDENT)

    def answer(self) -> bool:
        """
        Work out `torque` from what has been seen and what `controls` and `contacts` ask for.

        Returns
        -------
        bool
            Whether a torque limit was enforced.

        Raises
        ------
        SingularTaskError
            If the arm is in a singular posture.
        ContactGeometryError
            If the contacts' normals are not independent.

        """
        if self._coordinate_driven and self.started:
            self._follow_stiffness()
        terms = self.robot.terms
        status = control_law(
            self.controls, self.arm.joints, terms.mass_matrix, terms.jacobian,
            terms.jacobian_rate, self.contacts, self.laws)
        if status > LIMITED:
            self._refuse(status)
        return bool(status == LIMITED)

    def _follow_stiffness(self) -> None:
        """Redesign the observers of `paper` allocation when turning has changed k_s (eq. 17)."""
        factors = loop_stiffnesses(self.config, self.arm.pose.rotation_world) / self._stiffnesses
        if np.abs(factors - 1.0).max() > LARGEST_DRIFT:
            rescale(self.laws['observer'], factors)
            self._stiffnesses = self._stiffnesses * factors

    def output(self, torque: Vector) -> ControlOutput:
        """Return an answer to the sample that has been seen."""
        return ControlOutput(
            torque, np.frombuffer(self._contact_bytes.tobytes(), CONTACT),
            np.frombuffer(self._control_bytes.tobytes(), CONTROL))

    def _pose(self) -> Pose:
        position, rotation = self.arm.pose
        return Pose(position.copy(), rotation.copy())

    def _find_misread_friction(self) -> list[tuple[str, str, float]]:
        coupling = friction_coupling(self.contacts.copy(), self.arm.pose.rotation_world)
        names, contacts = self.config.column_names, self.config.contacts
        return [(names[j], names[i], float(coupling[i, j]))
                for j in self.config.leaders for i in range(len(names))
                if coupling[i, j] > LEVERED and not (
                    contacts[names[j]].friction_std or contacts[names[j]].friction_coefficient)]

    def account_for(self, torque: Vector) -> None:
        """
        Tell the force laws that another torque acts than the one that was answered.

        It accelerates the contact points by N^T J M^-1 Delta Gamma more (the coordinates along
        N_i, by `paper` allocation), and so does what is fed forward beyond the estimate, which a
        force that cannot be reached never makes good. So much is added to the input that they
        predict with.

        Parameters
        ----------
        torque
            What is commanded, blended and within all limits, shape (n,) [N m].

        """
        terms, active = self.robot.terms, self.active
        if not active.any():
            return
        M = np.triu(terms.mass_matrix)
        M += np.triu(M, 1).T
        N = self.contacts['N'][active].T
        answer = self.contacts['answer'][active]
        beyond = answer['alpha_fed'] - answer['alpha_est']
        twist_rate = terms.jacobian @ np.linalg.solve(
            M, torque - self.arm.joints['unlimited'] + terms.jacobian.T @ (N @ beyond))
        act_beyond(self.laws, active, (
            np.linalg.pinv(N) if self._coordinate_driven else N.T) @ twist_rate)

    def _refuse(self, status: int) -> NoReturn:
        """Raise what a status of `control_law` other than OK means."""
        if status == DEPENDENT:
            raise ContactGeometryError(
                'N: expected independent columns, found normals and contact points of '
                f'{", ".join(self.config.column_names)} that depend on each other')
        state = self.robot.update(self.arm.q, self.arm.velocity)
        task_inertia(state.mass_matrix, state.jacobian)  # says what is wrong
        raise SingularTaskError('J M^-1 J^T: expected a positive definite matrix')


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
    if len(config.robot.joint_names) > TASK_SIZE:
        w = config.posture.natural_frequency
        law['nullspace_damping'] = max(config.nullspace_damping, 2.0 * w)
        law['posture_stiffness'], law['stop_stiffness'] = w ** 2, (STOP_RATIO * w) ** 2
    law['least_share'] = LEAST_TASK_SHARE
    law['max_condition'] = MAX_CONDITION
    law['singular_mobility'] = SINGULAR_MOBILITY
    law['inertia_metric'] = force.projection == 'inertia'
    law['decoupled'] = force.allocation == 'decoupled'
    law['separated'] = any(
        config.contacts[name].friction_std or config.contacts[name].friction_coefficient
        for name in config.contact_names)
    law['force_noise'] = config.sensor.force_noise_std
    law['torque_noise'] = config.sensor.torque_noise_std
    return law


def place_columns(config: ControllerConfig, columns: Records) -> None:
    """Fill in what the configuration says of the columns, records of `CONTACT`, shape (r,)."""
    for record, column in zip(columns, config.columns):
        contact, is_force = config.contacts[column.contact], column.kind == FORCE
        record['kind'], record['leader'] = column.kind, column.leader
        told = contact.normal_world if is_force else (0.0, 0.0, 0.0)
        # A normal that has been found is kept while nothing else is told of it.
        if (record['normal_told'] != told).any() or not contact.normal_turn_rate:
            record['normal'] = record['normal_told'] = told
        record['normal_gain'] = config.period / (NORMAL_TIME + config.period)
        record['turn_limit'] = contact.normal_turn_rate * config.period
        record['smallest_cosine'] = math.cos(contact.normal_range)
        record['point'] = contact.point_operational
        record['direction'] = contact.direction_operational
        record['half_length'] = column.half_length
        record['stiffness'] = column.stiffness
        if is_force:
            record['surface_speed'] = contact.surface_speed
            record['surface_gain'] = config.period / (SURFACE_SPEED_TIME + config.period)
            limit = record['surface_speed_limit'] = contact.surface_speed_limit
            record['surface_speed_est'] = np.clip(record['surface_speed_est'], -limit, limit)
            record['friction_coefficient'] = contact.friction_coefficient
            record['friction_std'] = contact.friction_std
            record['torsion_std'] = 0.0 if contact.type == 'point' else (
                contact.friction_std * contact.half_length)


def loop_stiffnesses(config: ControllerConfig, rotation_world: Matrix) -> Vector:
    """
    Return the stiffness that the force loop of each contact drives, shape (r,) [N/m].

    Parameters
    ----------
    config
        Contacts, force loops.
    rotation_world
        Axes of the operational frame, shape (3, 3).

    """
    if config.force.allocation == 'decoupled':  # which drives the contact point itself
        return np.array([column.stiffness for column in config.columns])
    contacts = [config.contacts[name] for name in config.contact_names]
    return np.array([operational_stiffness(  # `paper` drives the coordinate along N_i
        contact.stiffness, np.array(contact.normal_world),
        -rotation_world @ np.array(contact.point_operational)) for contact in contacts])
