"""The paper's experiment as a reference: approach, force steps, a sinusoid blended in."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
import math

from multicontact_control.arrays import Mask, Vector
from multicontact_control.config import (
    Config,
    ContactStateConfig,
    parameter,
    Real,
    UnitVector3,
    validate,
)
from multicontact_control.control.reference.source import Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.errors import ConfigError
from multicontact_control.quintic import quintic
import numpy as np
from pydantic import model_validator

STILL = [0.0] * 3, [0.0] * 3  # velocity and acceleration


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
        Contacts, or their forces and couples, in the order of every contact vector.
    leader_of
        For each of them which one is the normal force of its contact; itself if not given.

    Raises
    ------
    ConfigError
        If a force step names an unknown contact.

    """

    def __init__(
        self, config: ReferenceConfig, *, rate: float, contact_names: tuple[str, ...],
        leader_of: Sequence[int] | None = None,
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
        self._leader_of = list(range(len(contact_names)) if leader_of is None else leader_of)
        self._is_force = np.array(self._leader_of) == np.arange(len(contact_names))
        motion = config.motion
        self._direction = motion.direction_world if motion is not None else (0.0, 0.0, 0.0)
        self._motion = motion
        self._motion_start = math.inf if motion is None else motion.start_time
        self._approach_start = config.approach.start_time

    def start(self, pose: Pose, normals_world: Vector) -> None:
        """Begin from a pose at rest; see `ReferenceSource.start`."""
        self._pose = pose
        self._normals = normals_world
        self._advance = np.zeros(self._count)
        self._active: Mask = np.zeros(self._count, dtype=bool)
        self._all_active = False
        self._steps_done, self._task_steps = -1, -2
        self._start: list[float] = pose.position_world.tolist()
        self._held = self._start
        self._rest: Reference | None = None

    def update(self, time: float, alpha_meas: Vector) -> Reference:
        """
        Return the reference of one tick; see `ReferenceSource.update`.

        Written for speed: once all contacts are there, it is the same object while at rest, and
        in motion three small arrays are all that is made.
        """
        approach = STILL if self._all_active else self._approach(time, alpha_meas)
        return self._reference(
            time, self._held, approach, self._active, self._desired_forces(time))

    def _reference(
        self, time: float, start: list[float], approach: tuple[list[float], list[float]],
        active: Mask, alpha_des: Vector,
    ) -> Reference:
        """Return the motion from a position, beside velocity and acceleration of an approach."""
        at_rest = approach is STILL and time <= self._motion_start
        rest = self._rest
        if at_rest and rest is not None and rest.active is active and rest.alpha_des is alpha_des:
            return rest
        s, ds, dds = 0.0, 0.0, 0.0
        if self._motion is not None:
            s, ds, dds = sine_motion(self._motion, time)
        x, y, z = self._direction
        (px, py, pz), (vx, vy, vz), (ax, ay, az) = start, *approach
        # Filled one by one: numpy takes twice as long for an array of a tuple.
        position, twist, acceleration = np.empty(3), np.zeros(6), np.zeros(6)
        position[0], position[1], position[2] = px + s * x, py + s * y, pz + s * z
        twist[0], twist[1], twist[2] = vx + ds * x, vy + ds * y, vz + ds * z
        acceleration[0], acceleration[1], acceleration[2] = (
            ax + dds * x, ay + dds * y, az + dds * z)
        reference = Reference(
            Pose(position, self._pose.rotation_world), twist, acceleration, active, alpha_des)
        self._rest = reference if at_rest else None
        return reference

    def _approach(self, time: float, alpha_meas: Vector) -> tuple[list[float], list[float]]:
        """Move on towards the surfaces not felt yet; return velocity and acceleration."""
        approach = self._config.approach
        since = time - approach.start_time
        if since >= 0.0:
            touched = (alpha_meas > approach.contact_threshold)[self._leader_of]
            self._active = self._active | touched
            self._all_active = bool(self._active.all())
            self._steps_done = -1  # the desired forces have changed
        speed, speed_rate = _ramp(since, approach.speed, approach.ramp_time)
        free = ~self._active
        direction = self._normals[free].sum(axis=0)
        if speed > 0.0 and not self._all_active:
            self._advance[free] += speed * self._period
            self._held = (self._pose.position_world + self._advance @ self._normals).tolist()
            return (speed * direction).tolist(), (speed_rate * direction).tolist()
        return STILL

    def contact_state(self, default: ContactStateConfig) -> ContactStateConfig:
        """Return how contacts are to be made; what the scenario says of it goes first."""
        approach = self._config.approach
        return validate(ContactStateConfig, {
            **default.model_dump(), 'approach_speed': approach.speed,
            'approach_ramp_time': approach.ramp_time,
            'contact_threshold': approach.contact_threshold, 'preload': approach.preload},
            'reference.approach')

    def task(self, time: float) -> Reference:
        """
        Return the motion, and the contacts of which a force is desired as wanted.

        These are all from the start of the approach on, until a step asks 0 N of one.

        Written for speed, as `update` is.
        """
        done = bisect_right(self._step_times, time + 1e-9)
        if time < self._approach_start:
            done = -1
        if done != self._task_steps:
            self._task_steps = done
            self._desired = self.forces_after(done) if done >= 0 else np.zeros(self._count)
            self._wanted: Mask = (self._desired > 0.0)[self._leader_of]
        return self._reference(time, self._start, STILL, self._wanted, self._desired)

    def forces_after(self, steps: int) -> Vector:
        """Return the desired forces after so many force steps, shape (r,) [N]."""
        desired = np.where(self._is_force, self._config.approach.preload, 0.0)
        for _, forces in self._steps[:steps]:
            desired = np.where(np.isnan(forces), desired, forces)
        return desired

    def _desired_forces(self, time: float) -> Vector:
        """Return alpha_des; made anew only when a step is due or a contact has been found."""
        done = bisect_right(self._step_times, time + 1e-9)
        if done != self._steps_done:
            self._steps_done = done
            self._alpha_des: Vector = np.where(self._active, self.forces_after(done), 0.0)
        return self._alpha_des


def _ramp(since: float, speed: float, ramp_time: float) -> tuple[float, float]:
    """Return a speed ramped up from 0, and its rate."""
    if since <= 0.0:
        return 0.0, 0.0
    if since < ramp_time:
        return speed * since / ramp_time, speed / ramp_time
    return speed, 0.0
