"""What the controller is asked to do at each tick, and the scenario that asks for it."""

from __future__ import annotations

from bisect import bisect_right
import math
from typing import NamedTuple, Protocol

from multicontact_control.arrays import Mask, Vector
from multicontact_control.config import (
    Config,
    ContactStateConfig,
    parameter,
    Real,
    UnitVector3,
)
from multicontact_control.dynamics.pose import Pose
from multicontact_control.errors import ConfigError
import numpy as np
from pydantic import model_validator


class Reference(NamedTuple):
    """
    The task of one tick; a named tuple, which is made faster than a dataclass.

    Attributes
    ----------
    pose_des
        Desired pose of the operational frame.
    twist_des, acceleration_des
        World axes, linear first, shape (6,) [m/s, rad/s; m/s^2, rad/s^2].
    active
        Which contacts are force controlled, shape (r,).
    alpha_des
        Desired contact forces, shape (r,) [N]; 0 where not active.

    """

    pose_des: Pose
    twist_des: Vector
    acceleration_des: Vector
    active: Mask
    alpha_des: Vector


class ReferenceSource(Protocol):
    """Where references come from: a scenario, or a user's commands."""

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """
        Begin from a pose at rest.

        Parameters
        ----------
        pose
            Pose of the operational frame now.
        normals_world
            Contact normals INTO the surfaces, shape (r, 3).

        """
        ...

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """
        Return the reference of one tick.

        Parameters
        ----------
        time
            Time since the start [s].
        alpha_meas
            Measured contact forces, shape (r,) [N].

        """
        ...


class TaskSource(Protocol):
    """What is to be done, without regard to whether the contacts are there."""

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        ...

    def task(self, time: float) -> Reference:
        """Return the motion, and the contacts that are wanted with the forces they are to have."""
        ...

    def contact_state(self, default: ContactStateConfig) -> ContactStateConfig:
        """Return how contacts are to be made for this task."""
        ...


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
    forces: dict[str, Real] = parameter(..., 'Desired force per contact.', unit='N')


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


class ScenarioReference:
    """
    The paper's experiment as a reference: approach, preload, force steps, sinusoid.

    `task` gives the time tables alone, for a `ContactReference` to find the contacts. `update`
    is the law without supervision: a contact counts as made for good once it was touched.

    Parameters
    ----------
    config
        The times and sizes of all that.
    rate
        Control rate [Hz].
    contact_names
        Contacts in the order of every contact vector.

    Raises
    ------
    ConfigError
        If a force step names an unknown contact.

    """

    def __init__(
        self, config: ReferenceConfig, *, rate: float, contact_names: tuple[str, ...],
    ) -> None:
        self._config = config
        self._period = 1.0 / rate
        self._steps = []
        for index, step in enumerate(config.force_steps):
            for name in step.forces:
                if name not in contact_names:
                    raise ConfigError(
                        f'reference.force_steps.{index}.forces',
                        f'contacts among {", ".join(contact_names)}', f"'{name}'")
            forces = np.array([step.forces.get(name, math.nan) for name in contact_names])
            self._steps.append((step.time, forces))
        self._step_times = [step.time for step in config.force_steps]
        self._count = len(contact_names)
        motion = config.motion
        self._direction = motion.direction_world if motion is not None else (0.0, 0.0, 0.0)
        self._motion = motion

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        self._pose = pose
        self._normals = normals_world
        self._advance = np.zeros(self._count)
        self._active: Mask = np.zeros(self._count, dtype=bool)
        self._all_active = False
        self._steps_done = -1
        self._held: list[float] = pose.position_world.tolist()

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """
        Return the reference of one tick; see `ReferenceSource.update`.

        Written for speed: once all contacts are there, three small arrays are all that is made.
        """
        approach: tuple[list[float], list[float]] = ([0.0] * 3, [0.0] * 3)
        if not self._all_active:
            approach = self._approach(time, alpha_meas)
        s, ds, dds = 0.0, 0.0, 0.0
        if self._motion is not None:
            s, ds, dds = sine_motion(self._motion, time)
        x, y, z = self._direction
        (px, py, pz), (vx, vy, vz), (ax, ay, az) = self._held, *approach
        position = np.array((px + s * x, py + s * y, pz + s * z))
        return Reference(
            Pose(position, self._pose.rotation_world),
            np.array((vx + ds * x, vy + ds * y, vz + ds * z, 0.0, 0.0, 0.0)),
            np.array((ax + dds * x, ay + dds * y, az + dds * z, 0.0, 0.0, 0.0)),
            self._active, self._desired_forces(time))

    def _approach(self, time: float, alpha_meas: Vector) -> tuple[list[float], list[float]]:
        """Move on towards the surfaces not felt yet; return velocity and acceleration."""
        approach = self._config.approach
        since = time - approach.start_time
        if since >= 0.0:
            self._active = self._active | (alpha_meas > approach.contact_threshold)
            self._all_active = bool(self._active.all())
            self._steps_done = -1  # the desired forces have changed
        speed, speed_rate = _ramp(since, approach.speed, approach.ramp_time)
        free = ~self._active
        direction = self._normals[free].sum(axis=0)
        if speed > 0.0 and not self._all_active:
            self._advance[free] += speed * self._period
            self._held = (self._pose.position_world + self._advance @ self._normals).tolist()
            return (speed * direction).tolist(), (speed_rate * direction).tolist()
        return [0.0] * 3, [0.0] * 3

    def contact_state(self, default: ContactStateConfig) -> ContactStateConfig:
        """Return how contacts are to be made; what the scenario says of it goes first."""
        approach = self._config.approach
        return default.model_copy(update={
            'approach_speed': approach.speed, 'approach_ramp_time': approach.ramp_time,
            'contact_threshold': approach.contact_threshold, 'preload': approach.preload})

    def task(self, time: float) -> Reference:
        """Return the motion, and from the start of the approach on all contacts as wanted."""
        wanted = time >= self._config.approach.start_time
        position, twist, acceleration = self._pose.position_world, np.zeros(6), np.zeros(6)
        if self._config.motion is not None:
            s, ds, dds = sine_motion(self._config.motion, time)
            direction = np.asarray(self._config.motion.direction_world)
            position = position + s * direction
            twist[:3] = ds * direction
            acceleration[:3] = dds * direction
        desired = np.full(self._count, self._config.approach.preload)
        for start, forces in self._steps:
            if time >= start - 1e-9:
                desired = np.where(np.isnan(forces), desired, forces)
        return Reference(
            Pose(position, self._pose.rotation_world), twist, acceleration,
            np.full(self._count, wanted), desired if wanted else np.zeros(self._count))

    def _desired_forces(self, time: float) -> Vector:
        """Return alpha_des; made anew only when a step is due or a contact has been found."""
        done = bisect_right(self._step_times, time + 1e-9)
        if done != self._steps_done:
            self._steps_done = done
            desired = np.full(self._count, self._config.approach.preload)
            for _, forces in self._steps[:done]:
                desired = np.where(np.isnan(forces), desired, forces)
            self._alpha_des: Vector = np.where(self._active, desired, 0.0)
        return self._alpha_des


class CommandedReference:
    """
    A reference that a user sets, over topics or from a program.

    Until a motion is commanded the pose at the start is held. A contact with a commanded force
    above 0 is force controlled.

    Parameters
    ----------
    contact_names
        Contacts in the order of every contact vector.

    """

    def __init__(self, contact_names: tuple[str, ...]) -> None:
        self._names = contact_names
        self._alpha_des = np.zeros(len(contact_names))
        self._pose: Pose | None = None
        self._twist = np.zeros(6)
        self._acceleration = np.zeros(6)

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        self._pose = pose
        self._twist = np.zeros(6)
        self._acceleration = np.zeros(6)
        self._alpha_des = np.zeros(len(self._names))

    def set_forces(self, forces: dict[str, float]) -> None:
        """
        Command contact forces; contacts that are not named keep theirs.

        Parameters
        ----------
        forces
            Desired force per contact [N]; 0 gives the contact back to motion control.

        Raises
        ------
        ConfigError
            If a name is unknown or a force is negative or not finite; nothing is changed then.

        """
        desired = self._alpha_des.copy()
        for name, force in forces.items():
            if name not in self._names:
                raise ConfigError('contact_forces/command',
                                  f'contacts among {", ".join(self._names)}', f"'{name}'")
            if not (math.isfinite(force) and force >= 0.0):
                raise ConfigError(f'contact_forces/command.{name}', 'a force >= 0 N', force)
            desired[self._names.index(name)] = force
        self._alpha_des = desired

    def set_motion(
        self, position_world: Vector, quaternion_xyzw: Vector, twist_world: Vector,
        acceleration_world: Vector,
    ) -> None:
        """
        Command the motion of the operational point.

        Parameters
        ----------
        position_world, quaternion_xyzw
            Desired pose, shapes (3,) [m] and (4,).
        twist_world, acceleration_world
            Shapes (6,), linear first.

        Raises
        ------
        ConfigError
            If a number is not finite or the quaternion has no length; nothing is changed then.

        """
        numbers = np.concatenate(
            [position_world, quaternion_xyzw, twist_world, acceleration_world])
        if not np.isfinite(numbers).all():
            raise ConfigError('motion/command', 'finite numbers', numbers.tolist())
        if np.linalg.norm(quaternion_xyzw) < 1e-6:
            raise ConfigError('motion/command', 'a quaternion of unit length',
                              quaternion_xyzw.tolist())
        self._pose = Pose.from_quaternion(position_world, quaternion_xyzw)
        self._twist = np.array(twist_world, dtype=float)
        self._acceleration = np.array(acceleration_world, dtype=float)

    def contact_state(self, default: ContactStateConfig) -> ContactStateConfig:
        """Return the default: a command says nothing of how contacts are made."""
        return default

    def task(self, time: float) -> Reference:
        """Return what is commanded; see `TaskSource.task`."""
        return self.update(time, self._alpha_des)

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """Return the reference of one tick; see `ReferenceSource.update`."""
        if self._pose is None:
            raise ConfigError('reference', 'start() before update()', 'update()')
        return Reference(
            pose_des=self._pose, twist_des=self._twist, acceleration_des=self._acceleration,
            active=self._alpha_des > 0.0, alpha_des=self._alpha_des)


def _ramp(since: float, speed: float, ramp_time: float) -> tuple[float, float]:
    """Return a speed ramped up from 0, and its rate."""
    if since <= 0.0:
        return 0.0, 0.0
    if since < ramp_time:
        return speed * since / ramp_time, speed / ramp_time
    return speed, 0.0


def sine_motion(config: SineConfig, time: float) -> tuple[float, float, float]:
    """
    Return displacement, speed and acceleration of the blended sinusoid.

    s = A b(tau / t_b) sin(2 pi tau / T), b the quintic 10 x^3 - 15 x^4 + 6 x^5.

    Parameters
    ----------
    config
        Amplitude A, period T, blend time t_b, start.
    time
        Scenario time [s].

    Returns
    -------
    tuple
        [m], [m/s], [m/s^2].

    """
    tau = time - config.start_time
    if tau <= 0.0:
        return 0.0, 0.0, 0.0
    w = 2.0 * math.pi / config.period
    sine, cosine = math.sin(w * tau), math.cos(w * tau)
    x = tau / config.blend_time
    if x >= 1.0:
        b, db, ddb = 1.0, 0.0, 0.0
    else:
        b = x ** 3 * (10.0 + x * (-15.0 + 6.0 * x))
        db = 30.0 * x ** 2 * (1.0 - x) ** 2 / config.blend_time
        ddb = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / config.blend_time ** 2
    A = config.amplitude
    return (A * b * sine, A * (db * sine + b * w * cosine),
            A * (ddb * sine + 2.0 * db * w * cosine - b * w * w * sine))
