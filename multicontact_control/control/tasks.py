"""What the arm is to do: by a scenario's times, or by a user's commands."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
import math
from typing import NamedTuple, Protocol

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import (
    Config,
    ControllerConfig,
    LimitsConfig,
    parameter,
)
from multicontact_control.control.motions import (
    MotionConfig,
    plan_motion,
    PlannedMotion,
    require_free_motion,
)
from multicontact_control.control.trajectory import Trajectory, TrajectoryFollower
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import ConfigError
import numpy as np

ZERO_TWIST = np.zeros(6)  # twist and acceleration
ZERO_TWIST.flags.writeable = False
STAMP_TOLERANCE = 1e-9  # s
DEFAULT_LIMITS = LimitsConfig()


class WantedTask(NamedTuple):
    """
    What a source wants at one tick, in world axes; forces and couples of shape (r,).

    The records have it as `control.wanted`, and what contacts and limits leave of it as
    `control.task`.
    """

    pose_des: Pose  # of the operational frame
    twist_des: Vector  # linear first, shape (6,) [m/s, rad/s]
    acceleration_des: Vector  # shape (6,) [m/s^2, rad/s^2]
    active: Mask  # which forces and couples are to be controlled
    alpha_des: Vector  # [N]


class TaskSource(Protocol):
    """
    Where tasks come from.

    Attributes
    ----------
    contact_state
        Fields of `ContactStateConfig` that they set.
    seeks
        Whether a contact is still to be made, if the source makes them.
    follower
        The way along a trajectory that stands still where the arm cannot follow; None if there is
        none.

    """

    contact_state: Mapping[str, float]
    seeks: bool
    follower: TrajectoryFollower | None

    def start(self, pose: Pose, normals_world: Matrix) -> None:
        """Begin from a pose at rest, beside contact normals INTO the surfaces, shape (r, 3)."""

    def task_at(self, time: float, alpha_meas: Vector | None = None) -> WantedTask:
        """
        Return the task at a time since the start [s].

        The source makes the contacts of measured forces, shape (r,) [N]; contact states without.
        What is the same object as at the time before is taken for the same: an array that was
        returned must not be changed.
        """


class MotionReading(NamedTuple):
    """A commanded motion of the operational point, in world axes."""

    position_world: Vector  # [m]
    quaternion_xyzw: Vector
    twist_world: Vector  # [m/s, rad/s]
    acceleration_world: Vector  # [m/s^2, rad/s^2]


class ApproachConfig(Config):
    """Guarded contact: towards every surface until it is felt."""

    start_time: float = parameter(0.5, 'When the approach starts.', unit='s', ge=0.0)
    speed: float = parameter(0.02, 'Approach speed.', unit='m/s', gt=0.0, le=0.25)
    ramp_time: float = parameter(0.5, 'Time to reach that speed.', unit='s', gt=0.0)
    contact_threshold: float = parameter(
        1.5, 'Measured force that counts as contact.', unit='N', gt=0.0
    )
    preload: float = parameter(
        2.0, 'Desired force from contact to first step.', unit='N', gt=0.0
    )


class ForceStepConfig(Config):
    """A step of the desired forces at one time; contacts that are not named keep theirs."""

    time: float = parameter(..., 'When.', unit='s', ge=0.0)
    forces: dict[str, float] = parameter(
        ..., 'Desired force per contact, and couple of an edge or plane.', unit='N'
    )


class ReferenceConfig(Config):
    """
    The scenario of an experiment: approach, force steps at rest, motion (P04 sec. 5.2).

    Times count from the first sample. A motion has a kind: `sine`, where none is named, `circle`,
    or `waypoints`.
    """

    approach: ApproachConfig = ApproachConfig()
    force_steps: tuple[ForceStepConfig, ...] = ()
    motion: MotionConfig | None = None

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        times = [step.time for step in self.force_steps]
        if times != sorted(times):
            yield ConfigError('reference.force_steps', 'times in rising order', times)


class ScenarioTask:
    """
    The paper's experiment: approach, preload, force steps, a motion (P04 sec. 5.2).

    A contact is wanted from the start of the approach on, while its desired force is above 0.
    Where the source makes the contacts, each is approached until it is felt, then active. A force
    step of an unknown contact is a ConfigError.

    Parameters
    ----------
    config, rate
        Times and sizes; control rate [Hz].
    names, leading_columns
        Forces and couples in the order of every contact vector, and for each the index of the
        normal force of its contact.
    limits
        Of the operational point, for which a motion is slowed down.

    Attributes
    ----------
    forces
        Desired ones before the first and after every force step, shape (steps + 1, r) [N].
    step_times
        Those of the force steps and of the waypoints with a force, in rising order [s].
    motion_end
        When the motion is at rest again, infinity for one that does not end [s].

    """

    # Its motion keeps the times of the scenario.
    follower: TrajectoryFollower | None = None

    def __init__(
        self,
        config: ReferenceConfig,
        rate: float,
        names: Sequence[str],
        leading_columns: Sequence[int],
        limits: LimitsConfig = DEFAULT_LIMITS,
    ) -> None:
        self._approach = config.approach
        self._period = 1.0 / rate
        self._names = tuple(names)
        self._motion: PlannedMotion | None = None
        self._motion_start = math.inf
        self.motion_end = math.inf
        steps = list(config.force_steps)
        if config.motion is not None:
            self._motion = plan_motion(config.motion, limits)
            self._motion_start = config.motion.start_time
            self.motion_end = self._motion.end
            for time, name, force in self._motion.force_steps:
                if name not in names:
                    raise ConfigError(
                        'reference.motion.contact',
                        f'one of {", ".join(names)}',
                        f"'{name}'",
                    )
                steps.append(ForceStepConfig(time=time, forces={name: force}))
            steps.sort(key=_step_time)
        self.contact_state: Mapping[str, float] = {
            'approach_speed': self._approach.speed,
            'approach_ramp_time': self._approach.ramp_time,
            'contact_threshold': self._approach.contact_threshold,
            'preload': self._approach.preload,
        }
        self._leading_columns = np.array(leading_columns)
        is_force = self._leading_columns == np.arange(len(names))
        preload = np.where(is_force, self._approach.preload, 0.0)
        self.forces = _forces_after_steps(steps, dict(zip(names, preload)))
        active = (self.forces > 0.0)[:, self._leading_columns]
        self._wanted_after_step = list(zip(active, self.forces))
        self._nothing_wanted = np.zeros(len(names), dtype=bool), np.zeros(len(names))
        self.step_times = [step.time for step in steps]

    @classmethod
    def for_controller(
        cls, reference: ReferenceConfig, config: ControllerConfig
    ) -> ScenarioTask:
        """Return the task of a scenario for the contacts of a controller; ConfigError."""
        task = cls(
            reference,
            config.rate,
            config.column_names,
            config.leading_columns,
            config.limits,
        )
        motion = reference.motion
        if motion is not None:
            steps_before = bisect_right(task.step_times, motion.start_time)
            rows = task.forces[steps_before:]  # those in force at its start, and later
            pressed = []
            for name, column in zip(config.contact_names, config.force_columns):
                if (rows[:, column] > 0.0).any():
                    pressed.append(name)
            require_free_motion(motion, config, pressed)
        return task

    def start(self, pose: Pose, normals_world: Matrix) -> None:
        """Begin from a pose at rest; see `TaskSource.start`."""
        self._pose = pose
        self._position = pose.position_world
        self._normals = normals_world
        self._touched: Mask = np.zeros(len(normals_world), dtype=bool)
        self._advance = np.zeros(len(normals_world))  # along each normal [m]
        self.seeks = True
        if self._motion is not None:
            normals = dict(zip(self._names, normals_world))
            self._motion.start(pose.position_world, normals)

    def task_at(self, time: float, alpha_meas: Vector | None = None) -> WantedTask:
        """Return the task of one tick; see `TaskSource.task_at`."""
        since_start = time - self._approach.start_time
        if since_start < 0.0:
            active, alpha_des = self._nothing_wanted
        else:
            steps_taken = bisect_right(self.step_times, time + STAMP_TOLERANCE)
            active, alpha_des = self._wanted_after_step[steps_taken]
        twist = acceleration = ZERO_TWIST
        if alpha_meas is not None:
            if self.seeks:
                twist, acceleration = self._approach_surfaces(since_start, alpha_meas)
                alpha_des = np.where(self._touched, alpha_des, 0.0)
            active = self._touched
        position = self._position
        if self._motion is not None and time > self._motion_start:
            displacement, velocity, change = self._motion.displace(time)
            position = position + displacement
            twist = twist + velocity
            acceleration = acceleration + change
        pose = Pose(position, self._pose.rotation_world)
        return WantedTask(pose, twist, acceleration, active, alpha_des)

    def _approach_surfaces(
        self, since_start: float, alpha_meas: Vector
    ) -> tuple[Vector, Vector]:
        """Go on to the surfaces that are not touched; return twist and acceleration."""
        approach = self._approach
        if since_start >= 0.0:
            touching = alpha_meas > approach.contact_threshold
            self._touched = self._touched | touching[self._leading_columns]
            self.seeks = not self._touched.all()
        if since_start <= 0.0:
            return ZERO_TWIST, ZERO_TWIST
        speed = approach.speed
        rate = 0.0
        if since_start < approach.ramp_time:
            speed = approach.speed * since_start / approach.ramp_time
            rate = approach.speed / approach.ramp_time
        free = ~self._touched
        self._advance[free] += speed * self._period
        self._position = self._pose.position_world + self._advance @ self._normals
        direction = np.zeros(6)
        direction[:3] = self._normals[free].sum(axis=0)
        return speed * direction, rate * direction


def _step_time(step: ForceStepConfig) -> float:
    """Return when a force step comes [s]."""
    return step.time


def _forces_after_steps(
    steps: Sequence[ForceStepConfig], preload: Mapping[str, float]
) -> Matrix:
    """Return desired forces before the first and after each step, (steps + 1, r) [N]."""
    forces = dict(preload)
    rows = [list(forces.values())]
    for index, step in enumerate(steps):
        unknown = step.forces.keys() - preload.keys()
        if unknown:
            raise ConfigError(
                f'reference.force_steps.{index}.forces',
                f'contacts among {", ".join(preload)}',
                f"'{min(unknown)}'",
            )
        forces |= step.forces
        rows.append(list(forces.values()))
    return np.array(rows)


class CommandedTask:
    """
    The task that a user sets, over topics or from a program; `CommandLimits` checks the commands.

    A motion is a stream of set points, or a trajectory that is followed to its end.

    Names and leaders are those of a `ScenarioTask`. Until a motion is commanded, `pose` is that
    of the start, and None before. A contact with a force above 0 is force controlled. The task is
    the same object until something else is commanded, or a motion has lasted long enough.
    """

    contact_state: Mapping[str, float] = {}
    seeks = False

    def __init__(self, names: Sequence[str], leading_columns: Sequence[int]) -> None:
        self._names = tuple(names)
        self._leading_columns = np.array(leading_columns)
        self.start(None, np.empty((0, 3)))

    def start(self, pose: Pose | None, normals_world: Matrix) -> None:
        """Forget all commands, and begin from a pose at rest; see `TaskSource.start`."""
        self.pose = pose
        self._twist = self._acceleration = ZERO_TWIST
        self._lasting = math.inf  # how long these two count from the next tick on [s]
        self._until = math.inf  # the same as a time; NaN until that tick [s]
        self._alpha_des = np.zeros(len(self._names))
        self._active: Mask = np.zeros(len(self._names), dtype=bool)
        self._shares = np.full(len(self._names), math.nan)
        self._task: WantedTask | None = None
        self.follower: TrajectoryFollower | None = None
        self._next_trajectory: Trajectory | None = None
        self._ends_trajectory = False  # once it has come to a stop
        self._time = math.nan  # of the tick before [s]

    def set_forces(
        self,
        forces: Mapping[str, float],
        shares: Mapping[str, float] | None = None,
    ) -> bool:
        """
        Command forces and couples by name [N], the others stay; return whether any is new.

        A force of 0 gives the contact back to motion control. Couples act while their contact
        does; those among `shares` follow its force: the centre of pressure in half lengths.
        """
        before = self._alpha_des
        desired = before.copy()
        followed = self._shares.copy()
        for name, force in forces.items():
            column = self._names.index(name)
            desired[column] = force
            followed[column] = math.nan
        for name, share in (shares or {}).items():
            followed[self._names.index(name)] = share
        follows = ~np.isnan(followed)
        leading_forces = desired[self._leading_columns]
        desired[follows] = followed[follows] * leading_forces[follows]
        self._alpha_des = desired
        self._shares = followed
        self._active = (desired > 0.0)[self._leading_columns]
        self._task = None
        return bool((desired != before).any())

    @property
    def forces(self) -> dict[str, float]:
        """Commanded forces and couples by name [N]."""
        return dict(zip(self._names, self._alpha_des.tolist()))

    @property
    def shares(self) -> dict[str, float]:
        """Couples that follow the force of their contact, relative to it, by name."""
        return {
            name: share
            for name, share in zip(self._names, self._shares.tolist())
            if not math.isnan(share)
        }

    def set_motion(
        self,
        motion: MotionReading,
        taken_normals: Matrix,
        lasting: float = math.inf,
    ) -> None:
        """
        Command a pose, and a twist and acceleration that count for so long [s].

        Along `taken_normals`, shape (k, 3), of the contacts that are sought or held, these place
        the tip: the command has no effect, now or later.
        """
        position = np.array(motion.position_world, dtype=float)
        twist = np.array(motion.twist_world, dtype=float)
        acceleration = np.array(motion.acceleration_world, dtype=float)
        if len(taken_normals) and self.pose is not None:
            N = taken_normals.T
            across = np.eye(3) - N @ np.linalg.pinv(N)
            start = self.pose.position_world
            position = start + across @ (position - start)
            twist[:3] = across @ twist[:3]
            acceleration[:3] = across @ acceleration[:3]
        quaternion = np.array(motion.quaternion_xyzw, dtype=float)
        self.pose = Pose.from_quaternion(position, quaternion)
        self._twist = twist
        self._acceleration = acceleration
        self._lasting = lasting
        self._until = math.nan
        self._task = None
        self.follower = None
        self._next_trajectory = None

    @property
    def stopping_pose(self) -> Pose | None:
        """Where the pose comes to rest if a trajectory is stopped now; None before the start."""
        if self.follower is None:
            return self.pose
        return self.follower.stopping_pose

    def stop_trajectory(self) -> None:
        """Bring the trajectory that is followed, if any, to a stop, and forget it then."""
        self._next_trajectory = None
        self._ends_trajectory = True

    def keep_trajectory(self) -> None:
        """Go on with a trajectory that was to stop."""
        self._ends_trajectory = False

    def set_trajectory(self, trajectory: Trajectory, *, at_once: bool = False) -> None:
        """Follow a trajectory, `at_once` or as soon as another one has come to a stop."""
        if self.follower is None or at_once:
            self._follow(trajectory)
        else:
            self._next_trajectory = trajectory
            self._ends_trajectory = True

    def _follow(self, trajectory: Trajectory | None) -> None:
        """Follow a trajectory, or none and stay."""
        self.follower = None
        self._twist = self._acceleration = ZERO_TWIST
        self._until = math.inf
        self._task = None
        self._next_trajectory = None
        self._ends_trajectory = False
        if trajectory is not None:
            self.follower = TrajectoryFollower(trajectory)

    def _advance_trajectory(self, follower: TrajectoryFollower, period: float) -> None:
        """Go on along a trajectory for a period [s]; once it is over, to the next or none."""
        if self._ends_trajectory:
            follower.waits = True
        state = follower.advance(period)
        self.pose = state.pose
        self._twist = state.twist_world
        self._acceleration = state.acceleration_world
        self._task = None
        is_over = follower.time >= follower.trajectory.duration
        if is_over or (self._ends_trajectory and follower.pace == 0.0):
            self._follow(self._next_trajectory)

    def task_at(self, time: float, alpha_meas: Vector | None = None) -> WantedTask:
        """Return the commanded task; see `TaskSource.task_at`."""
        if self.follower is not None:
            self._advance_trajectory(self.follower, max(0.0, time - self._time))
        self._time = time
        if math.isnan(self._until):
            self._until = time + self._lasting
        if time > self._until:
            self._twist = self._acceleration = ZERO_TWIST
            self._until = math.inf
            self._task = None
        if self._task is None:
            if self.pose is None:
                raise ConfigError('reference', 'start() before task_at()', 'task_at()')
            self._task = WantedTask(
                self.pose,
                self._twist,
                self._acceleration,
                self._active,
                self._alpha_des,
            )
        return self._task


class SteeredTask(CommandedTask):
    """
    A commanded task whose pose goes on with its twist, for commands that come slowly.

    A commanded motion is that of the next tick; its twist and acceleration carry it on from there,
    as long as they count.
    """

    def task_at(self, time: float, alpha_meas: Vector | None = None) -> WantedTask:
        """Return the task, carried on since the tick before; see `TaskSource.task_at`."""
        moves = self._twist is not ZERO_TWIST and time <= self._until
        if moves and self.pose is not None:
            elapsed = time - self._time
            change = elapsed * self._acceleration
            self.pose = self.pose.moved_by(elapsed * (self._twist + 0.5 * change))
            self._twist = self._twist + change
            self._task = None
        return super().task_at(time, alpha_meas)
