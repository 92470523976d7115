"""The control law around its compiled core: from joint state, wrench, R and task to torque."""

from __future__ import annotations

import contextlib
import math
from typing import NamedTuple

from multicontact_control.algebra import quintic_blend
from multicontact_control.arrays import Mask, Vector
from multicontact_control.config import ControllerConfig, ToolConfig
from multicontact_control.contact.geometry import check_columns, configure_contacts
from multicontact_control.contact.resolution import check_resolution
from multicontact_control.contact.wrench import interpolate_tool, make_tool_record
from multicontact_control.control.arm import ArmState
from multicontact_control.control.law import control_law, LAW_SPACE, LawSpace
from multicontact_control.control.motion_observer import forget_disturbance
from multicontact_control.dynamics.operational_space import (
    choose_posture,
    MAX_MOBILITY_CONDITION,
)
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import (
    ConfigError,
    ContactGeometryError,
    MulticontactError,
    SingularTaskError,
)
from multicontact_control.flags import (
    COLUMNS_DEPENDENT,
    FORCES_AMBIGUOUS,
    MODEL_NOT_FINITE,
    POSTURE_SINGULAR,
    TORQUE_LIMITED,
)
from multicontact_control.force.force_law import (
    continue_laws,
    ForceLaw,
    make_force_laws,
)
from multicontact_control.records import (
    CONTACT,
    Contact,
    CONTROL,
    Control,
    ForceAnswer,
    Frame,
    LAW,
    Law,
    Records,
    Task,
)
import numpy as np

# Frequency by which joints are kept off their stops, over the posture's.
STOP_RATIO = 4.0
SINGULAR_MOBILITY = 0.004  # 1/kg, eigenvalue of J M^-1 J^T up to which Lambda is damped
LEAST_TASK_SHARE = 0.5  # of the task at a torque limit; the rest is cut joint by joint


class ControlOutput(NamedTuple):
    """The answer to one sample; its records cannot be written to."""

    torque: Vector  # Gamma, shape (n,) [N m]
    memory: bytes  # a copy of the controller's

    @property
    def controls(self) -> Records[Control]:
        """Return one record of `CONTROL`: the arm, and what it is asked for."""
        return np.frombuffer(self.memory, CONTROL, count=1)

    @property
    def contacts(self) -> Records[Contact]:
        """Return records of `CONTACT`, all that there is to say of every contact, shape (r,)."""
        return np.frombuffer(self.memory, CONTACT, offset=CONTROL.itemsize)

    def without_force_answers(self) -> ControlOutput:
        """Return the same for contacts that no law controls."""
        contacts = self.contacts.copy()
        contacts['answer'] = 0
        controls = self.memory[: CONTROL.itemsize]
        return self._replace(memory=controls + np.asarray(contacts).tobytes())

    @property
    def pose(self) -> Pose:
        """Return the pose of the operational frame."""
        frame: Frame = self.controls['frame'][0]
        return Pose(frame['position'], frame['rotation'])

    @property
    def pose_des(self) -> Pose:
        """Return the desired pose of the operational frame."""
        task: Task = self.controls['task'][0]
        return Pose(task['position'], task['rotation'])

    @property
    def answer(self) -> Records[ForceAnswer]:
        """
        Return what the law makes of every contact, records of `FORCE_ANSWER`, shape (r,).

        Estimates and desired forces are 0 where no force is controlled; `innovation`,
        `prior_variance` and `variance_used` also for the sample with which control starts.
        """
        answer: Records[ForceAnswer] = self.contacts['answer']
        return answer


class ControllerDesign(NamedTuple):
    """What a configuration of a controller leads to."""

    config: ControllerConfig
    laws: Records[ForceLaw]  # shape (r,), which know nothing yet; for one use


class Controller:
    """
    Multi-contact compliant motion control of one arm (P04 sec. 3-4).

    F = Lambda (Omega_m f_t* + Omega_c f_c*) + mu + p + f_c_hat, Gamma = J^T F (eqs 24-26).

    It holds the records that `tick` works on. The law alone, of a task in `controls` and
    `contacts`, is `take_sample` and `answer`. `start` comes before the first answer of either.

    Parameters
    ----------
    config
        Everything tunable.
    robot
        The arm.

    Attributes
    ----------
    arm
        Where the arm is.
    controls, contacts, laws, fresh_laws
        One record of `CONTROL`, records of `CONTACT` and `FORCE_LAW`, shape (r,); the last are the
        laws before they know anything.
    memory
        The bytes of the first two.
    tool, next_tool
        What hangs on the sensor now, and the one that is configured; see `advance_tool_change`.
    active, torque
        Which contacts are force controlled, shape (r,), and the answer, shape (n,) [N m].
    resolutions
        How well the configuration tells the contacts apart.
    started
        Whether the force laws have begun, by `start`, since a reset.

    Raises
    ------
    ConfigError
        If one wrist sensor cannot tell the contacts apart, or its noise hides them.

    """

    def __init__(self, config: ControllerConfig, robot: RobotModel) -> None:
        count = len(config.columns)
        self.robot = robot
        # In one piece, so that an answer is one copy.
        self.memory = np.zeros(
            CONTROL.itemsize + count * CONTACT.itemsize, dtype=np.uint8
        )
        self.controls: Records[Control] = self.memory[: CONTROL.itemsize].view(CONTROL)
        self.contacts: Records[Contact] = self.memory[CONTROL.itemsize :].view(CONTACT)
        self.controls['measured'] = True
        self.controls['task']['rotation'] = np.eye(3)
        configure_contacts(config, self.contacts)
        check_columns(config.column_names, self.contacts)
        self.arm = ArmState(robot, self.controls, self.contacts)
        self.active: Mask = self.contacts['answer']['active']
        self.torque: Vector = self.arm.joints['answer']['torque']
        self._space: LawSpace = np.zeros(1, dtype=LAW_SPACE)[0]
        self._in_urdf = config.tool
        self.next_tool = config.tool
        self._set_configuration(config)
        self._carry_tool(config.tool)
        self.resolutions = check_resolution(config, self.controls, self.contacts)
        self.reset()
        self.arm.pose.quaternion_xyzw  # noqa: B018 - no step is to wait for it to be compiled
        self.laws: Records[ForceLaw] = make_force_laws(config)
        self.fresh_laws = self.laws.copy()
        with contextlib.suppress(SingularTaskError, ContactGeometryError):
            self.answer()  # all joints at 0 need not be a good posture
        continue_laws(self.fresh_laws.copy(), self.laws)  # as a live change does
        self.reset()

    def _set_configuration(self, config: ControllerConfig) -> None:
        """Set everything that follows from the configuration alone."""
        self.config = config
        self.controls['law'] = make_law_record(config)
        self._set_motion_observer(config)
        is_input = config.wrench_input == 'momentum'
        self.controls['momentum']['config']['is_input'] = is_input
        joints = self.arm.joints['config']
        joints['coulomb'] = config.friction.coulomb or 0.0
        joints['viscous'] = config.friction.viscous or 0.0
        joints['torque_limit'] = config.torque_limit or np.inf
        joints['lower'] = config.limits.joint_lower or -np.inf
        joints['upper'] = config.limits.joint_upper or np.inf
        joints['told_posture'] = config.posture.joints or math.nan

    def _set_motion_observer(self, config: ControllerConfig) -> None:
        """Set the gains of the motion's observer; what is not observed any more is 0."""
        motion = config.motion
        pole = math.exp(-motion.observer_bandwidth * config.period)
        observer = self.controls['motion_observer']
        observer['config']['twist_gain'] = 1.0 - pole**2
        observer['config']['disturbance_gain'] = (1.0 - pole) ** 2 / config.period
        observer['config']['delay'] = round(config.force.input_delay / config.period)
        if motion.observer_bandwidth == 0.0:
            observer['running'] = False
            observer['disturbance'] = 0.0
        share = 0.0
        # The wrench that the residual stands for has friction in the joints in it, too.
        if motion.friction_time > 0.0 and config.wrench_input != 'momentum':
            share = 1.0 - math.exp(-config.period / motion.friction_time)
        observer['config']['friction_share'] = share

    def _carry_tool(self, tool: ToolConfig) -> None:
        """Take a tool off the readings (by momentum they are without it), and bear its weight."""
        self.tool = tool
        felt = tool
        if self.config.wrench_input == 'momentum':
            felt = ToolConfig()
        gravity_world = np.array(self.config.robot.gravity_world)
        self.controls['tool'] = make_tool_record(felt, gravity_world)
        self.robot.carry_load(tool, self._in_urdf)

    def advance_tool_change(self) -> None:
        """Go a tick on from one tool to the next: weight, inertia and bias together."""
        self._slewed += 1
        elapsed = self._slewed * self.config.period
        share = quintic_blend(elapsed, self.config.transition.slew_time)[0]
        self._carry_tool(interpolate_tool(self._last_tool, self.next_tool, share))

    def reset(self) -> None:
        """Forget everything measured; the next sample starts anew."""
        self.started = False
        forget_disturbance(self.controls[0])
        self._carry_tool(self.next_tool)
        self.contacts['normal'] = self.contacts['config']['normal']
        self.contacts['surface_speed_est'] = 0.0

    def design(self, config: ControllerConfig) -> ControllerDesign:
        """
        Return what another configuration leads to, which changes nothing; see `use`.

        It may take long, and be called in another thread than `answer`.

        Raises
        ------
        ConfigError
            For another arm, contacts or rate, or what cannot be of these.

        """
        for name in ('rate', 'robot', 'contact_names', 'column_names'):
            present = getattr(self.config, name)
            wanted = getattr(config, name)
            if wanted != present:
                raise ConfigError(
                    name,
                    str(present),
                    wanted,
                    hint='it cannot change while the controller is in use',
                )
        mass = self.robot.last_mass
        if mass + config.tool.mass <= self._in_urdf.mass:
            raise ConfigError(
                'tool.mass',
                f'above {self._in_urdf.mass - mass:.4g} kg',
                config.tool.mass,
                hint='the last link of the URDF weighs '
                f'{mass:.4g} kg, with the {self._in_urdf.mass:.4g} kg of its tool',
            )
        columns = self.contacts.copy()
        configure_contacts(config, columns)
        check_columns(config.column_names, columns)  # normals may be others
        check_resolution(config, self.controls, columns)
        return ControllerDesign(config, make_force_laws(config))

    def use(self, design: ControllerDesign) -> None:
        """Go on with other gains; the force laws keep what they know as far as possible."""
        config = design.config
        if config.tool != self.next_tool:
            self._last_tool = self.tool
            self.next_tool = config.tool
            self._slewed = 0
        if config.contacts != self.config.contacts:
            # What is learnt of surfaces stays.
            configure_contacts(config, self.contacts)
        self._set_configuration(config)
        self.fresh_laws[:] = design.laws
        if self.started:
            continue_laws(design.laws, self.laws)
            self.laws[:] = design.laws

    def take_sample(self, q: Vector, qd: Vector, wrench_sensor: Vector) -> None:
        """
        See a sample that no input stage has taken in.

        Joint positions [rad] and velocities [rad/s], shape (n,), and what the wrist sensor reads
        in its frame, force first, shape (6,) [N, N m].
        """
        self.arm.q[:] = q
        self.arm.velocity[:] = qd
        self.controls['wrench'] = wrench_sensor
        self.arm.take_motion()

    def begin(self) -> Pose:
        """Take note that the force laws begin; return the pose from which a task starts."""
        self._carry_tool(self.next_tool)
        self.started = True
        position, rotation = self.arm.pose
        return Pose(position.copy(), rotation.copy())

    def start(self) -> Pose:
        """Let the force laws begin; return the pose from which a task starts."""
        self.laws[:] = self.fresh_laws
        choose_posture(self.arm.joints)
        return self.begin()

    def answer(self) -> bool:
        """
        Compute `torque` from what has been seen and what `controls` and `contacts` ask for.

        Returns
        -------
        bool
            Whether a torque limit was enforced.

        Raises
        ------
        SingularTaskError
            If the arm is in a singular posture, or its model gives no finite numbers.
        ContactGeometryError
            If the contacts' normals are not independent.

        """
        if self.arm.flags & (FORCES_AMBIGUOUS | MODEL_NOT_FINITE):
            raise self.explain_no_answer(self.arm.flags)
        found = control_law(
            self.controls[0],
            self.arm.joints,
            self.robot.terms,
            self.contacts,
            self.laws,
            self._space,
        )
        if found & (POSTURE_SINGULAR | COLUMNS_DEPENDENT):
            raise self.explain_no_answer(found)
        return bool(found & TORQUE_LIMITED)

    def drive_gravity_torque(self) -> Vector:
        """Return the torque by which drives with `adds_gravity` carry the arm, (n,) [N m]."""
        if self.config.robot.adds_tool_gravity:
            return self.robot.gravity.copy()
        return self.robot.gravity - self.robot.compute_load_torque(self.tool)

    def explain_no_answer(self, found: int) -> MulticontactError:
        """Return the error of what `tick` or `control_law` has found instead of an answer."""
        if not self.arm.has_finite_terms:
            return SingularTaskError(
                "the arm's dynamics: expected finite numbers, got others at joint positions "
                f'{self.arm.q.tolist()} and velocities {self.arm.velocity.tolist()}'
            )
        if found & (COLUMNS_DEPENDENT | FORCES_AMBIGUOUS):
            return ContactGeometryError(
                'N: expected independent columns, got normals and contact points of '
                f'{", ".join(self.config.column_names)} that depend on each other'
            )
        state = self.robot.update(self.arm.q, self.arm.velocity)
        eigenvalues = np.linalg.eigvalsh(
            state.jacobian @ np.linalg.solve(state.mass_matrix, state.jacobian.T)
        )
        return SingularTaskError(
            f'J M^-1 J^T: expected a condition number below {MAX_MOBILITY_CONDITION:g}, '
            f'got eigenvalues from {eigenvalues[0]:.3g} to {eigenvalues[-1]:.3g}'
        )


def make_law_record(config: ControllerConfig) -> Records[Law]:
    """Return gains and options of the control law as one record of `LAW`."""
    motion = config.motion
    force = config.force
    frequency = motion.natural_frequency
    law = np.zeros(1, dtype=LAW)
    law['k_p'] = frequency**2
    law['k_v'] = 2.0 * motion.damping_ratio * frequency
    law['K_2'] = force.damping_rate
    law['friction_speed'] = config.friction.speed
    law['nullspace_damping'] = config.nullspace_damping
    if len(config.robot.joint_names) > 6:  # which have no null space
        w = config.posture.natural_frequency
        law['nullspace_damping'] = max(config.nullspace_damping, 2.0 * w)
        law['posture_stiffness'] = w**2
        law['stop_stiffness'] = (STOP_RATIO * w) ** 2
    law['least_share'] = LEAST_TASK_SHARE
    law['singular_mobility'] = SINGULAR_MOBILITY
    law['inertia_metric'] = force.projection == 'inertia'
    law['decoupled'] = force.allocation == 'decoupled'
    for name in config.contact_names:
        contact = config.contacts[name]
        if contact.friction_std or contact.friction_coefficient:
            law['separated'] = True
    law['period'] = config.period
    law['force_noise'] = config.sensor.force_noise_std
    law['torque_noise'] = config.sensor.torque_noise_std
    return law
