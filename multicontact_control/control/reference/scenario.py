"""The paper's experiment as a reference."""

from __future__ import annotations

from bisect import bisect_right
import math

from multicontact_control.arrays import Mask, Vector
from multicontact_control.config import ContactStateConfig
from multicontact_control.control.reference.scenario_config import ReferenceConfig
from multicontact_control.control.reference.sine import sine_motion
from multicontact_control.control.reference.source import Reference
from multicontact_control.dynamics.pose import Pose
from multicontact_control.errors import ConfigError
import numpy as np


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
        self._steps_done, self._task_steps = -1, -2
        self._start: list[float] = pose.position_world.tolist()
        self._held = self._start

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
        """
        Return the motion, and from the start of the approach on all contacts as wanted.

        Written for speed, as `update` is.
        """
        done = bisect_right(self._step_times, time + 1e-9)
        if time < self._config.approach.start_time:
            done = -1
        if done != self._task_steps:
            self._task_steps = done
            self._wanted: Mask = np.full(self._count, done >= 0)
            self._desired = self.forces_after(done) if done >= 0 else np.zeros(self._count)
        s, ds, dds = 0.0, 0.0, 0.0
        if self._motion is not None:
            s, ds, dds = sine_motion(self._motion, time)
        x, y, z = self._direction
        px, py, pz = self._start
        return Reference(
            Pose(np.array((px + s * x, py + s * y, pz + s * z)), self._pose.rotation_world),
            np.array((ds * x, ds * y, ds * z, 0.0, 0.0, 0.0)),
            np.array((dds * x, dds * y, dds * z, 0.0, 0.0, 0.0)), self._wanted, self._desired)

    def forces_after(self, steps: int) -> Vector:
        """Return the desired forces after so many force steps, shape (r,) [N]."""
        desired = np.full(self._count, self._config.approach.preload)
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
