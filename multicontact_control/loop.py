"""
The middle of the closed loop: samples and commands in, torques out.

Nothing else turns samples into torques: the node, the simulation in process, the faults and the
benchmark step a `ControlLoop`.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from pathlib import Path
from typing import NamedTuple

from multicontact_control.arrays import Vector
from multicontact_control.config import ControllerConfig, LimitsConfig
from multicontact_control.contact.geometry import offset_shares, project_on_contacts
from multicontact_control.control.controller import ControllerDesign, ControlOutput
from multicontact_control.control.tasks import CommandedTask, MotionReading, TaskSource
from multicontact_control.control.trajectory import (
    Trajectory,
    TrajectoryFollower,
    TrajectoryProgress,
)
from multicontact_control.control.trajectory_checks import (
    check_points,
    check_surfaces,
    TimedPoses,
)
from multicontact_control.dynamics.robot import RobotModel
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.sensor.push_test import CANCELLED, PushGate, PushTestConfig
from multicontact_control.sensor.tool import compute_tare_bias, MAX_REST_SPEED
from multicontact_control.supervision.command_limits import check_motion, CommandLimits
from multicontact_control.supervision.input_checks import RECENT_WRENCHES
from multicontact_control.supervision.inputs import TickInputs
from multicontact_control.supervision.report import EventLog, SupervisorStatus
from multicontact_control.supervision.supervisor import Supervisor, unsupervised_error
import numpy as np

# m and rad of a commanded motion that contacts do not leave free, up to which it is not reported:
# a tool that follows a surface leaves the height that was commanded, too.
UNREPORTED_DISTANCE = 0.005
UNREPORTED_ANGLE = 0.05
STOPPING_ERROR = 1e-5  # m or rad, by which a stopped trajectory may be off its place
STREAM_TIME = 1.0  # s; commands that come more often than this are a stream
VELOCITIES_IN_DOUBT = (
    'the joint velocities are in doubt (joints_velocity): prove them in motion, '
    'or ~/retry'
)


class TrajectoryRequest(NamedTuple):
    """A path that was checked, and that is still to be planned."""

    start: Pose  # at rest
    points: TimedPoses
    limits: LimitsConfig
    place: Pose | None  # of the task
    replaced: TrajectoryFollower | None

    # Whether it begins where that comes to a stop, and not where the arm is.
    stops: bool

    def plan(self) -> Trajectory:
        """Return the trajectory through the points; any thread may wait for it. CommandError."""
        return Trajectory(self.start, self.points, self.limits)


class ControlLoop:
    """
    A controller between activation and deactivation: samples in, torques out, and its commands.

    Every command raises `CommandError` if it cannot be obeyed now.

    Parameters
    ----------
    config
        The controller's.
    scenario
        What to do; None to obey commands.
    limits
        Of those commands.
    base_dir
        Folder that relative paths start from.
    supervised
        Whether contact states, watchdogs and limits are around the control law.

    Attributes
    ----------
    output, status
        The answer to the newest sample, None before the first and in the safe behaviour, and what
        the supervisor did, None if not supervised.
    events, time
        What it did since the last restart, each at the stamp of the newest sample less the first,
        as a recording has it; and the supervisor's time of the newest tick [s].
    push_gate, warnings, remark
        What allows force control, what is suspicious of the arm's model, and how noisy the
        contact forces are.

    """

    def __init__(
        self,
        config: ControllerConfig,
        scenario: TaskSource | None,
        limits: CommandLimits,
        base_dir: Path,
        *,
        supervised: bool = True,
    ) -> None:
        if config.wrench_input == 'momentum' and not supervised:
            raise ConfigError(
                'wrench_input', 'raw or filtered without a supervisor', 'momentum'
            )
        limits.check(config)
        self.limits = limits
        source = scenario or CommandedTask(config.column_names, config.leading_columns)
        self._commanded: CommandedTask | None = None
        if isinstance(source, CommandedTask):
            self._commanded = source
        robot = RobotModel(config.robot, base_dir)
        self.warnings = robot.list_warnings(config.torque_limit)
        self.supervisor = Supervisor(config, robot, source, guarded=supervised)
        resolutions = ', '.join(map(str, self.supervisor.controller.resolutions))
        self.remark = (
            'standard deviation of the contact forces by the noise of the sensor: '
            f'{resolutions}'
        )
        self.push_gate = PushGate(
            required=config.sensor.require_push_test,
            gravity_world=np.array(config.robot.gravity_world),
            rate=config.rate,
        )
        self.restart()

    @property
    def config(self) -> ControllerConfig:
        """Return the configuration in force, which `reconfigure` and `use` replace as a whole."""
        return self.supervisor.config

    @property
    def held(self) -> bool:
        """Whether pose and forces are held, by `hold`: commands are refused until a release."""
        return self.supervisor.task.held

    def restart(self) -> None:
        """
        Forget the past: the next sample is the first.

        Commands, contacts, torques and events are forgotten; what is configured stays.
        """
        self.supervisor.reset()
        self.push_gate.restart_test()
        self.output: ControlOutput | None = None
        self.status: SupervisorStatus | None = None
        self.events = EventLog()
        self._inputs = TickInputs(0.0)
        self.time = 0.0
        self._commanded_at = -math.inf  # the newest new force [s]

    def step(self, inputs: TickInputs) -> Vector:
        """
        Answer the newest readings, however old, with the torque to command, shape (n,) [N m].

        If not supervised: MulticontactError if a reading is missing, or there is no torque for
        this posture.
        """
        self._inputs = inputs
        self.time = inputs.time
        output, status = self.supervisor.step(inputs)
        self.output = output
        if self.supervisor.safe:
            self.output = None
        if status is self.status:
            self.events.repeats += 1
        elif status is not None:
            self.events.note_status(inputs.time - inputs.ahead, status)
        self.status = status
        if self.push_gate.phase:
            self._continue_push_test(inputs)
        return output.torque

    def stop(self) -> Vector:
        """
        Answer the newest sample by the safe behaviour, as all that follow until a restart.

        Returns the torque, shape (n,) [N m], which starts from the one that acts.
        """
        self.supervisor.stop()
        return self.step(self._inputs)

    def _continue_push_test(self, inputs: TickInputs) -> None:
        """Take a sample with a new wrench into a push test; allow force control once it passes."""
        if self.supervisor.velocities_on_probation:
            self.push_gate.fail_test(VELOCITIES_IN_DOUBT)
        if self.output is None or not self.push_gate.phase:
            return
        joints = inputs.joints
        wrench = inputs.wrench
        stage = self.supervisor.inputs
        if not stage.wrench_arrived or not joints or not wrench:
            return
        frame = self.supervisor.controller.arm.frames[0]
        if (
            joints.stamp == wrench.stamp
            and self.push_gate.take_sample(frame, stage.raw_wrench, self.config.tool)
            and self.push_gate.open
        ):
            self.supervisor.gate.start_blend()
            self.supervisor.task.set_lock(False)

    def _require_rest(self, purpose: str) -> None:
        """Refuse what is only possible with a wrist sensor that nothing presses on."""
        if self.config.wrench_input == 'momentum':
            raise CommandError(
                'wrench_input', got='momentum', hint=f'a {purpose} needs a wrist sensor'
            )
        if self.output is not None and self.output.answer['active'].any():
            raise CommandError('contacts', hint='let go of them first: command 0 N')
        if self.supervisor.presses_contact:
            raise CommandError('contacts', hint='wait: a reaction still presses one')

    def push_test(self, config: PushTestConfig) -> str:
        """Begin a push test, for which the arm stays where it is; return what to do now."""
        self._require_rest('push test')
        if self.supervisor.velocities_on_probation:
            raise CommandError('push test', hint=VELOCITIES_IN_DOUBT)
        points = {}
        for name, contact in self.config.contacts.items():
            points[name] = np.array(contact.point_operational)
        self.push_gate.start_test(config, points)
        self.supervisor.gate.start_blend()
        self.supervisor.task.set_lock(True)
        return self.push_gate.instruction

    def cancel_push_test(self) -> str:
        """
        Take back a push test, see `PushGate.cancel_test`; return what is allowed now, in words.

        Force control is allowed again if an earlier test was passed or none is required.
        """
        self.push_gate.cancel_test()
        self.supervisor.gate.start_blend()
        self.supervisor.task.set_lock(not self.push_gate.open)
        return self.push_gate.instruction or CANCELLED

    def reconfigure(self, config: ControllerConfig) -> None:
        """
        Go on with another configuration from the next sample on.

        ConfigError and nothing changed if that cannot be. It may take longer than a period: where
        samples come meanwhile, call `design` in another thread, then `use`.
        """
        self.use(self.design(config))

    def design(self, config: ControllerConfig) -> ControllerDesign:
        """Return what to go on with; see `Controller.design`: another thread may wait for it."""
        self._keep_pushed_tool(config)
        return self.supervisor.controller.design(config)

    def use(self, design: ControllerDesign) -> None:
        """
        Go on with what has been designed, without a jump of the torque.

        CommandError if a push test runs meanwhile and the tool is another.
        """
        self._keep_pushed_tool(design.config)  # a push test may have begun meanwhile
        self.supervisor.adopt_design(design)

    def _keep_pushed_tool(self, config: ControllerConfig) -> None:
        """Refuse another tool while a push test runs."""
        if self.push_gate.running and config.tool != self.config.tool:
            raise CommandError(
                'tool', hint='wait: it cannot change while a push test runs'
            )

    def set_forces(
        self,
        forces: dict[str, float],
        centres: Mapping[str, float] | None = None,
    ) -> None:
        """
        Obey forces and couples by name [N]; a change after a second or more is a `retry`, too.

        `centres` has the centre of pressure instead of a couple, by the couple's name: from the
        centre of the contact, along its direction or across it [m].
        """
        task = self._require_commanded_task()
        shares = offset_shares(self.config, centres or {})
        followed = task.shares
        for name in forces:
            followed.pop(name, None)
        self.limits.check_forces(
            self.config, forces, before=task.forces, shares=followed | shares
        )
        if task.set_forces(forces, shares):
            if not self.time - self._commanded_at <= STREAM_TIME:
                self.supervisor.request_retry()
            self._commanded_at = self.time

    def set_motion(self, motion: MotionReading) -> str:
        """
        Obey a commanded motion, as far as contacts that are sought or held leave it free.

        Returns what they do not, in words; empty if that is next to nothing.
        """
        task = self._require_commanded_task()
        check_motion(motion, self.config.limits)
        unfree_part = self._describe_unfree_part(motion)
        task.set_motion(
            motion, self.supervisor.task.sought_normals(), self.limits.motion_timeout
        )
        return unfree_part

    def set_trajectory(self, points: TimedPoses) -> None:
        """
        Follow a path through timed poses from where the arm is, in place of any other motion.

        None of them ends a trajectory. Planning may take longer than a period: where samples come
        meanwhile, call `request_trajectory`, then `plan` of what it returns in another thread,
        then `follow` or `keep_trajectory`.
        """
        if len(points.times):
            check_points(points, self.config.limits)
        request = self.request_trajectory(points)
        if request is None:
            return
        try:
            trajectory = request.plan()
        except CommandError:
            self.keep_trajectory()
            raise
        self.follow(request, trajectory)

    def request_trajectory(self, points: TimedPoses) -> TrajectoryRequest | None:
        """
        Bring a trajectory that is followed to a stop; return what to plan instead of it.

        `check_points` accepts the points. None if there are none, which ends a trajectory.
        CommandError if the path leads through a surface that is pressed, or off it. Along the
        normals of contacts that are sought or held the path has no effect, now or later; there it
        is replaced by the present place.
        """
        if len(points.times) == 0:
            if self._commanded is not None:
                self._commanded.stop_trajectory()
            return None
        task = self._require_commanded_task()
        limits = self.config.limits
        contact_task = self.supervisor.task
        start = contact_task.reference_pose()
        stops = False
        if task.follower is not None and not contact_task.catching_up:
            start = task.follower.stopping_pose
            stops = True
        if self.output is not None:  # where the contacts have brought the tool
            columns = contact_task.pressed_columns()
            check_surfaces(points, self.output.pose_des, columns)
        normals = contact_task.sought_normals()
        ways = points.positions_world - start.position_world
        if len(normals):
            ways = ways - ways @ np.linalg.pinv(normals) @ normals
        path = points._replace(positions_world=start.position_world + ways)
        if path.twists_world is not None and len(normals):
            twists = path.twists_world.copy()
            twists[:, :3] -= twists[:, :3] @ np.linalg.pinv(normals) @ normals
            path = path._replace(twists_world=twists)
        if stops:
            task.stop_trajectory()
        return TrajectoryRequest(start, path, limits, task.pose, task.follower, stops)

    def follow(self, request: TrajectoryRequest, trajectory: Trajectory) -> None:
        """Follow what was planned for a request; CommandError if the task is another by now."""
        task = self._require_commanded_task()
        place = task.stopping_pose
        unchanged = task.follower is request.replaced
        if request.replaced is None:
            unchanged = unchanged and place is request.place
        elif request.stops and task.follower is None and place is not None:
            # It has come to a stop meanwhile.
            way = place.displacement_to(request.start)
            unchanged = bool(np.abs(way).max() < STOPPING_ERROR)
        if not unchanged:
            raise CommandError(
                'trajectory', hint='another motion was commanded meanwhile'
            )
        task.set_trajectory(trajectory, at_once=not request.stops)

    def keep_trajectory(self) -> None:
        """Go on with the trajectory that a request has stopped, if that cannot be planned."""
        if self._commanded is not None:
            self._commanded.keep_trajectory()

    @property
    def progress(self) -> TrajectoryProgress | None:
        """How far the trajectory is that is followed; None if there is none."""
        if self._commanded is None or self._commanded.follower is None:
            return None
        return self._commanded.follower.progress

    def _describe_unfree_part(self, motion: MotionReading) -> str:
        """Return which part of the way to a commanded motion contacts do not leave free."""
        placing = self.supervisor.task.placing_columns()
        if self.output is None or not placing:
            return ''
        goal = Pose.from_quaternion(motion.position_world, motion.quaternion_xyzw)
        way = self.output.pose_des.displacement_to(goal)
        placed = project_on_contacts(way, np.array(list(placing.values())))
        distance, angle = np.linalg.norm(placed.reshape(2, 3), axis=1).tolist()
        if distance <= UNREPORTED_DISTANCE and angle <= UNREPORTED_ANGLE:
            return ''
        return (
            f'{1e3 * distance:.3g} mm and {angle:.3g} rad of the way are not obeyed: there '
            f'{", ".join(placing)} place the tool until they are let go (0 N)'
        )

    @property
    def commanded_forces(self) -> dict[str, float]:
        """Return the commanded forces and couples by name [N]; none while a scenario is played."""
        if self._commanded is None:
            return {}
        return self._commanded.forces

    def _require_commanded_task(self) -> CommandedTask:
        """Return the task that obeys commands now; CommandError if there is none."""
        if self._commanded is None:
            raise CommandError('reference_file', hint='the controller plays a scenario')
        self._require_running()
        if self.held:
            raise CommandError('~/hold', hint='the arm is held; release the hold first')
        return self._commanded

    def _require_running(self) -> None:
        """Refuse a command unless the law has begun with the task."""
        if self.output is None:
            raise CommandError(
                'controller', hint='it is inactive, or has no samples yet'
            )
        if self.supervisor.task.locked:
            raise CommandError(
                '~/push_test', hint=f'pass it first: {self.push_gate.instruction}'
            )
        if not self.supervisor.started:
            hint = 'wait: it has not begun'
            if self.status is not None and self.status.causes:
                hint += f' ({", ".join(self.status.causes)})'
            raise CommandError('control', hint=hint)

    def hold(self, wanted: bool) -> str:
        """
        Hold the present pose and the desired forces, or go on; return what happens now.

        A released task goes on where it was held.
        """
        self._require_running()
        if not wanted:
            self.supervisor.request_retry()
        if wanted or self.held:
            self.supervisor.gate.start_blend()
            self.supervisor.task.set_hold(wanted)
        return 'held' if wanted else 'released'

    def retry(self) -> str:
        """
        Resume control that is latched, and seek contacts given up; return what happens now.

        CommandError if there is nothing to resume.
        """
        if not self.supervisor.guarded:
            raise unsupervised_error()
        if not self.supervisor.request_retry():
            raise CommandError('control', hint='nothing to resume')
        return 'trying again'

    def tare(self) -> Vector:
        """
        Return the bias by which the compensated wrench would read zero, by `compute_tare_bias`.

        CommandError if the arm presses on something or moves, which would be taken for bias, or if
        there is no sensor, or a fault of it.
        """
        self._require_rest('tare')
        if fault := self.supervisor.inputs.sensor_fault:
            raise CommandError('wrench', 'one without faults', fault)
        oldest = self.time - (RECENT_WRENCHES - 0.5) * self.config.period
        readings, velocities = self.supervisor.inputs.recent_wrenches(oldest)
        fastest = np.abs(velocities.sum(axis=0)).max() / max(len(readings), 1)
        if fastest > MAX_REST_SPEED:
            raise CommandError(
                'joint speeds',
                f'at most {MAX_REST_SPEED:g} rad/s',
                f'{fastest:.3g} rad/s',
            )
        rotation_world = self.supervisor.controller.arm.frames['sensor_rotation'][0]
        return compute_tare_bias(
            readings,
            rotation_world,
            self.config.tool,
            np.array(self.config.robot.gravity_world),
        )
