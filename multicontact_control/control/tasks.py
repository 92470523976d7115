"""What the arm is to do: by a scenario's times, or by a user's commands."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
import math
from typing import NamedTuple, Protocol

from multicontact_control.arrays import Mask, Matrix, Vector
from multicontact_control.config import Config, parameter, Real, UnitVector3
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import ConfigError
from multicontact_control.quintic import quintic
import numpy as np
from pydantic import model_validator


class Task(NamedTuple):
    """
    What is wanted at one tick.

    Attributes
    ----------
    pose_des
        Desired pose of the operational frame.
    twist_des, acceleration_des
        World axes, linear first, shape (6,) [m/s, rad/s; m/s^2, rad/s^2].
    active
        Which forces and couples are to be controlled, shape (r,).
    alpha_des
        Desired forces and couples, shape (r,) [N].

    """

    pose_des: Pose
    twist_des: Vector
    acceleration_des: Vector
    active: Mask
    alpha_des: Vector


class TaskSource(Protocol):
    """
    Where tasks come from.

    Attributes
    ----------
    contact_state
        Fields of `ContactStateConfig` that the tasks set.

    """

    contact_state: Mapping[str, float]

    def start(self, pose: Pose, normals_world: Matrix) -> None:
        """Begin from a pose at rest, beside contact normals INTO the surfaces, shape (r, 3)."""
        ...

    def task(self, time: float, alpha_meas: Vector | None = None) -> Task:
        """
        Return the task of one tick.

        Parameters
        ----------
        time
            Since the start [s].
        alpha_meas
            Measured forces, shape (r,) [N], of which the source makes the contacts; None where
            contact states do.

        """
        ...


class MotionReading(NamedTuple):
    """A commanded pose, twist and acceleration of the operational point, in world axes."""

    position_world: Vector
    quaternion_xyzw: Vector
    twist_world: Vector
    acceleration_world: Vector


class ApproachConfig(Config):
    """Guarded contact: towards every surface until it is felt."""

    start_time: Real = parameter(0.5, 'When the approach starts.', unit='s', ge=0.0)
    speed: Real = parameter(0.02, 'Approach speed.', unit='m/s', gt=0.0, le=0.25)
    ramp_time: Real = parameter(0.5, 'Time to reach that speed.', unit='s', gt=0.0)
    contact_threshold: Real = parameter(
        1.5, 'Measured force that counts as contact.', unit='N', gt=0.0)
    preload: Real = parameter(2.0, 'Desired force from contact to first step.', unit='N', gt=0.0)


class ForceStepConfig(Config):
    """A step of the desired forces."""

    time: Real = parameter(..., 'When.', unit='s', ge=0.0)
    forces: dict[str, Real] = parameter(
        ..., 'Desired force per contact, and couple of an edge or plane.', unit='N')


class SineConfig(Config):
    """A sinusoid along one direction, blended in."""

    start_time: Real = parameter(..., 'When the motion starts.', unit='s', ge=0.0)
    direction_world: UnitVector3 = parameter((1.0, 0.0, 0.0), 'Unit direction, world axes.')
    amplitude: Real = parameter(0.15, 'Amplitude.', unit='m', ge=0.0)
    period: Real = parameter(8.0, 'Period.', unit='s', gt=0.0)
    blend_time: Real = parameter(2.0, 'Duration of the quintic blend-in.', unit='s', gt=0.0)


class ReferenceConfig(Config):
    """Approach, force steps at rest, motion (P04 sec. 5.2)."""

    approach: ApproachConfig = ApproachConfig()
    force_steps: tuple[ForceStepConfig, ...] = ()
    motion: SineConfig | None = None

    @model_validator(mode='after')
    def _check_order(self) -> ReferenceConfig:
        times = [step.time for step in self.force_steps]
        if times != sorted(times):
            raise ConfigError('reference.force_steps', 'times in rising order', times)
        return self


def sine_motion(config: SineConfig, time: float) -> tuple[float, float, float]:
    """
    Return displacement [m], speed [m/s] and acceleration [m/s^2] of the blended sinusoid.

    s = A b(tau / t_b) sin(2 pi tau / T), b the `quintic`.
    """
    tau = time - config.start_time
    if tau <= 0.0:
        return 0.0, 0.0, 0.0
    w = 2.0 * math.pi / config.period
    sine, cosine = math.sin(w * tau), math.cos(w * tau)
    b, db, ddb = quintic(tau, config.blend_time)
    A = config.amplitude
    return (A * b * sine, A * (db * sine + b * w * cosine),
            A * (ddb * sine + 2.0 * db * w * cosine - b * w * w * sine))


class ScenarioTask:
    """
    The paper's experiment: approach, preload, force steps, sinusoid (P04 sec. 5.2).

    Parameters
    ----------
    config
        Times and sizes.
    rate
        Control rate [Hz].
    names
        Forces and couples in the order of every contact vector.
    leader_of
        For each of them the index of the normal force of its contact; its own if not given.

    Attributes
    ----------
    forces
        Desired forces and couples before the first and after every force step, (steps + 1, r) [N].

    Raises
    ------
    ConfigError
        If a force step names an unknown contact.

    """

    def __init__(
        self, config: ReferenceConfig, rate: float, names: Sequence[str],
        leader_of: Sequence[int] | None = None,
    ) -> None:
        self._approach, self._motion, self._period = config.approach, config.motion, 1.0 / rate
        self._direction = np.array(config.motion.direction_world if config.motion else [0.0] * 3)
        self.contact_state: Mapping[str, float] = {
            'approach_speed': config.approach.speed,
            'approach_ramp_time': config.approach.ramp_time,
            'contact_threshold': config.approach.contact_threshold,
            'preload': config.approach.preload}
        self._leader_of = np.array(range(len(names)) if leader_of is None else leader_of)
        rows = [np.where(self._leader_of == np.arange(len(names)), config.approach.preload, 0.0)]
        for index, step in enumerate(config.force_steps):
            for name in step.forces:
                if name not in names:
                    raise ConfigError(f'reference.force_steps.{index}.forces',
                                      f'contacts among {", ".join(names)}', f"'{name}'")
            rows.append(np.array([
                step.forces.get(name, force) for name, force in zip(names, rows[-1].tolist())]))
        self.forces: Matrix = np.array(rows)
        self._wanted: list[tuple[Mask, Vector]] = [
            ((row > 0.0)[self._leader_of], row) for row in (*rows, np.zeros(len(names)))]
        self._step_times = [step.time for step in config.force_steps]

    def start(self, pose: Pose, normals_world: Matrix) -> None:
        """Begin from a pose at rest; see `TaskSource.start`."""
        self._pose, self._normals = pose, normals_world
        self._touched: Mask = np.zeros(len(normals_world), dtype=bool)
        self._advance = np.zeros(len(normals_world))

    def task(self, time: float, alpha_meas: Vector | None = None) -> Task:
        """
        Return the task of one tick; see `TaskSource.task`.

        A contact is wanted from the start of the approach on, while its desired force is above
        0. Given `alpha_meas` it is approached until it is touched, and active from then on.
        """
        since = time - self._approach.start_time
        done = bisect_right(self._step_times, time + 1e-9) if since >= 0.0 else -1
        active, alpha_des = self._wanted[done]
        position, twist, acceleration = self._pose.position_world, np.zeros(6), np.zeros(6)
        if alpha_meas is not None:
            position, twist[:3], acceleration[:3] = self._seek(since, alpha_meas)
            active, alpha_des = self._touched, np.where(self._touched, alpha_des, 0.0)
        motion = self._motion
        if motion is not None and time > motion.start_time:
            s, ds, dds = sine_motion(motion, time)
            position = position + s * self._direction
            twist[:3] += ds * self._direction
            acceleration[:3] += dds * self._direction
        return Task(
            Pose(position, self._pose.rotation_world), twist, acceleration, active, alpha_des)

    def _seek(self, since: float, alpha_meas: Vector) -> tuple[Vector, Vector, Vector]:
        """Return position, velocity and acceleration of the way to the surfaces not touched."""
        approach, direction, speed, rate = self._approach, np.zeros(3), 0.0, 0.0
        if since >= 0.0:
            felt = alpha_meas > approach.contact_threshold
            self._touched = self._touched | felt[self._leader_of]
        free = ~self._touched
        if since > 0.0 and free.any():
            speed = approach.speed
            if since < approach.ramp_time:
                speed, rate = speed * since / approach.ramp_time, speed / approach.ramp_time
            self._advance[free] += speed * self._period
            direction = self._normals[free].sum(axis=0)
        return (self._pose.position_world + self._advance @ self._normals, speed * direction,
                rate * direction)


class CommandedTask:
    """
    The task that a user sets, over topics or from a program.

    Until a motion is commanded the arm stays at its start. A contact with a commanded force above
    0 is force controlled.

    Parameters
    ----------
    names, leader_of
        As for a `ScenarioTask`.

    Attributes
    ----------
    pose
        The commanded pose, None before the start.

    """

    contact_state: Mapping[str, float] = {}

    def __init__(self, names: Sequence[str], leader_of: Sequence[int] | None = None) -> None:
        self._names = tuple(names)
        self._leader_of = np.array(range(len(names)) if leader_of is None else leader_of)
        self.pose: Pose | None = None
        self._forget()

    def _forget(self) -> None:
        self._twist, self._acceleration = np.zeros(6), np.zeros(6)
        self._lasting = self._until = math.inf  # of these two [s]; NaN until the next tick
        self._alpha_des = np.zeros(len(self._names))
        self._shares = np.full(len(self._names), math.nan)

    def start(self, pose: Pose, normals_world: Matrix) -> None:
        """Begin from a pose at rest; see `TaskSource.start`."""
        self._forget()
        self.pose = pose

    def set_forces(
        self, forces: Mapping[str, float], shares: Mapping[str, float] | None = None,
    ) -> bool:
        """
        Command contact forces; contacts that are not named keep theirs.

        Parameters
        ----------
        forces
            Desired force per contact [N]; 0 gives the contact back to motion control. Couples
            have either sign, and act while their contact does.
        shares
            Couples relative to the force of their contact, which they follow: the centre of
            pressure in half lengths.

        Returns
        -------
        bool
            Whether the command differs from the one before.

        Raises
        ------
        ConfigError
            If a name is unknown or a force is negative or not finite; nothing is changed then.

        """
        desired, followed = self._alpha_des.copy(), self._shares.copy()
        for name, force in forces.items():
            index = self._index(name)
            couple = self._leader_of[index] != index
            if not (math.isfinite(force) and (couple or force >= 0.0)):
                raise ConfigError(f'contact_forces/command.{name}', 'a finite couple' if couple
                                  else 'a force >= 0 N', force)
            desired[index], followed[index] = force, math.nan
        for name, share in (shares or {}).items():
            index = self._index(name)
            if self._leader_of[index] == index or not math.isfinite(share):
                raise ConfigError(f'contact_forces/command.{name}',
                                  'a finite share of a couple', share)
            followed[index] = share
        known = ~np.isnan(followed)
        desired[known] = followed[known] * desired[self._leader_of][known]
        changed = bool((desired != self._alpha_des).any())
        self._alpha_des, self._shares = desired, followed
        return changed

    def _index(self, name: str) -> int:
        if name not in self._names:
            raise ConfigError('contact_forces/command',
                              f'contacts among {", ".join(self._names)}', f"'{name}'")
        return self._names.index(name)

    @property
    def forces(self) -> dict[str, float]:
        """Return the commanded forces and couples by name [N]."""
        return dict(zip(self._names, self._alpha_des.tolist()))

    @property
    def shares(self) -> dict[str, float]:
        """Return the couples that follow the force of their contact, relative to it, by name."""
        return {name: share for name, share in zip(self._names, self._shares.tolist())
                if not math.isnan(share)}

    def set_motion(
        self, motion: MotionReading, taken_normals: Matrix, lasting: float = math.inf,
    ) -> None:
        """
        Command the motion of the operational point.

        Parameters
        ----------
        motion
            Pose, twist, acceleration.
        taken_normals
            Normals of the contacts that are sought or held, shape (k, 3): along them the contacts
            place the tip, and the command has no effect, now or later.
        lasting
            How long twist and acceleration count without another command [s].

        Raises
        ------
        ConfigError
            If a number is not finite or the quaternion has no length; nothing is changed then.

        """
        position, quaternion, twist, acceleration = (np.array(x, dtype=float) for x in motion)
        numbers = np.concatenate([position, quaternion, twist, acceleration])
        if not (np.isfinite(numbers).all() and np.linalg.norm(quaternion) > 1e-6):
            raise ConfigError('motion/command', 'finite numbers and a quaternion of unit length',
                              numbers.tolist())
        if len(taken_normals) and self.pose is not None:
            N = taken_normals.T
            across = np.eye(3) - N @ np.linalg.pinv(N)
            start = self.pose.position_world
            position = start + across @ (position - start)
            twist[:3], acceleration[:3] = across @ twist[:3], across @ acceleration[:3]
        self.pose = Pose.from_quaternion(position, quaternion)
        self._twist, self._acceleration = twist, acceleration
        self._lasting, self._until = lasting, math.nan

    def task(self, time: float, alpha_meas: Vector | None = None) -> Task:
        """Return the commanded task; see `TaskSource.task`."""
        if self.pose is None:
            raise ConfigError('reference', 'start() before task()', 'task()')
        if math.isnan(self._until):
            self._until = time + self._lasting
        if time > self._until:
            self._twist, self._acceleration = np.zeros(6), np.zeros(6)
        return Task(self.pose, self._twist, self._acceleration,
                    (self._alpha_des > 0.0)[self._leader_of], self._alpha_des)
