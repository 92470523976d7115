"""A motion there and back: what a situation asks of an arm, setpoint by setpoint."""

from __future__ import annotations

from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.control.tasks import MotionReading
from multicontact_control.dynamics.rotations import Pose
import numpy as np
from scipy.spatial.transform import Rotation

RAMP_TIME = 0.3  # s, of the speed of a motion
REST_TIME = 1.0  # s, at each end of a motion


class Course(NamedTuple):
    """
    A motion from a pose, there and back: along a direction and about an axis.

    Both are unit vectors in world axes, or 0. Ramps of 0.3 s let the acceleration begin at 0 and
    stay below 5/s times the speed.
    """

    start: Pose
    direction: Vector
    axis: Vector
    distance: float  # [m or rad]
    speed: float  # [m/s or rad/s]
    legs: int  # 0 for no motion

    @property
    def leg_time(self) -> float:
        """
        How long it takes in one direction, and to rest there [s].

        The ramps at both ends add a single ramp time: on each the way is half of what full speed
        makes. The rest of 1 s lets the arm come to its setpoint.
        """
        return self.distance / self.speed + RAMP_TIME + REST_TIME

    @property
    def duration(self) -> float:
        """
        How long it takes in all [s]: the legs with the rest after each; 0 without a motion.

        After that the setpoint stays, at the start after an even number of legs.
        """
        return self.legs * self.leg_time

    @property
    def period(self) -> float:
        """
        Return the period of a sinusoid of this amplitude and largest speed [s].

        For an amplitude A and angular frequency omega the largest speed is A omega.
        `situation.motion` `sine` takes the course's distance as amplitude.
        """
        return 2.0 * np.pi * self.distance / self.speed

    def way_at(self, time: float) -> Vector:
        """
        Return way [m or rad], rate and its rate at a time since its beginning [s], (3,).

        Before the beginning all three are 0; after the end the way stays at the start or the far
        end. On a leg back the way falls from the far end with the same profile.
        """
        if time <= 0.0:
            return np.zeros(3)
        far_end = np.array([self.distance, 0.0, 0.0])
        if time >= self.duration:
            return far_end * (self.legs % 2)
        leg, elapsed = divmod(time, self.leg_time)
        way = _smooth_run(elapsed, self.distance, self.speed)
        returns = leg % 2 == 1
        if returns:
            return far_end - way
        return way

    def setpoints(self, ways: Matrix) -> list[MotionReading]:
        """
        Return the setpoints of some ways [m or rad] with their rates, shape (k, 3).

        A setpoint is the pose of the operational point, world axes, with twist and acceleration,
        linear first. The turn is about the world axis, through the point itself.
        """
        turns = Rotation.from_rotvec(ways[:, :1] * self.axis)
        quaternions = (turns * Rotation.from_quat(self.start.quaternion_xyzw)).as_quat()
        twist = np.concatenate([self.direction, self.axis])  # of a unit rate
        setpoints = []
        for (way, rate, acceleration), quaternion in zip(ways.tolist(), quaternions):
            position = self.start.position_world + way * self.direction
            setpoints.append(
                MotionReading(position, quaternion, rate * twist, acceleration * twist)
            )
        return setpoints


def _smooth_run(elapsed: float, distance: float, speed: float) -> Vector:
    """Return way, rate and its rate of a motion of constant speed with smooth ramps, (3,)."""
    brake_time = distance / speed
    return _ramp(elapsed, speed) + _ramp(elapsed - brake_time, -speed)


def _ramp(elapsed: float, speed: float) -> Vector:
    """Return way, rate and its rate of a point that takes up a speed at time 0, (3,)."""
    share = min(max(elapsed / RAMP_TIME, 0.0), 1.0)
    time_at_speed = max(elapsed - RAMP_TIME, 0.0)
    return speed * np.array(
        [
            RAMP_TIME * (share**3 - 0.5 * share**4) + time_at_speed,
            share**2 * (3.0 - 2.0 * share),
            6.0 * share * (1.0 - share) / RAMP_TIME,
        ]
    )
