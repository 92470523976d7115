"""Timed poses that a path is to go through, and why some are refused."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import NamedTuple

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import LimitsConfig
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CommandError
import numpy as np
from scipy.spatial.transform import Rotation

AXES = 'position x', 'position y', 'position z'
SURFACE_DISTANCE = 0.005  # m that a path may lead out of a surface that is pressed...
LARGEST_SINE = 0.5  # ...or the sine of the angle to it: some surfaces are tilted
LARGEST_TURN = 2.9  # rad between two points; half a turn could go either way
QUATERNION_TOLERANCE = 0.01  # of its length from 1


class TimedPoses(NamedTuple):
    """
    Points of a path of the operational point in world axes, k of them.

    Without twists, a spline goes through the points.
    """

    times: Vector  # from the start on, rising, shape (k,) [s]
    positions_world: Matrix  # shape (k, 3) [m]
    quaternions_xyzw: Matrix  # shape (k, 4)
    twists_world: Matrix | None = None  # linear first, shape (k, 6) [m/s, rad/s]


def check_position(position_world: Vector, limits: LimitsConfig) -> None:
    """Refuse a position outside the workspace box, if any: CommandError names the axis."""
    for name, x, lower, upper in zip(
        AXES, position_world, limits.workspace_lower, limits.workspace_upper
    ):
        if not lower <= x <= upper:
            raise CommandError(name, f'{lower:g} to {upper:g} m', f'{x:g} m')


def check_points(points: TimedPoses, limits: LimitsConfig) -> None:
    """
    Refuse points that are no path: CommandError names the first such point, from 0 on.

    There is a point, all numbers are finite, times rise from 0 or later, quaternions have unit
    length and turn by less than half a turn, and positions are within the workspace box.
    """
    if len(points.times) == 0:
        raise CommandError('points', 'at least one', 'none')
    parts = [
        points.times[:, np.newaxis],
        points.positions_world,
        points.quaternions_xyzw,
    ]
    if points.twists_world is not None:
        parts.append(points.twists_world)
    numbers = np.hstack(parts)
    lengths = np.linalg.norm(points.quaternions_xyzw, axis=1)
    steps = np.diff(points.times, prepend=-math.inf)
    for index in range(len(points.times)):
        place = f'point {index}'
        if not np.isfinite(numbers[index]).all():
            raise CommandError(place, 'finite numbers', numbers[index].tolist())
        if not abs(lengths[index] - 1.0) <= QUATERNION_TOLERANCE:
            raise CommandError(
                f'{place}: quaternion',
                'a length of 1',
                points.quaternions_xyzw[index].tolist(),
            )
        time = f'{points.times[index]:g} s'
        if points.times[index] < 0.0:
            raise CommandError(f'{place}: time', 'at least 0 s', time)
        if not steps[index] > 0.0:
            before = points.times[index - 1]
            raise CommandError(
                f'{place}: time',
                f'more than {before:g} s, the time of the point before',
                time,
            )
        try:
            check_position(points.positions_world[index], limits)
        except CommandError as error:
            raise CommandError(
                f'{place}: {error.field}', error.expected, error.got
            ) from None
    turns = turns_between(Rotation.from_quat(points.quaternions_xyzw))
    angles = np.linalg.norm(turns, axis=1)
    for index in np.flatnonzero(angles > LARGEST_TURN).tolist():
        raise CommandError(
            f'point {index + 1}: turn from the point before',
            f'at most {LARGEST_TURN:g} rad',
            f'{angles[index]:.3g} rad',
        )


def turns_between(rotations: Rotation) -> Matrix:
    """Return the turns from each of k orientations to the next, in its frame, (k - 1, 3) [rad]."""
    if len(rotations) == 1:
        return np.zeros((0, 3))  # scipy of Ubuntu 24.04 composes no empty rotations
    turns: Matrix = (rotations[:-1].inv() * rotations[1:]).as_rotvec()
    return turns


def check_surfaces(
    points: TimedPoses, start: Pose, columns: Mapping[str, Vector]
) -> None:
    """
    Refuse a path that leads through surfaces that are pressed, or off them.

    Their contacts place the tool there, and a path has no effect. It may be off by what a tilted
    or curved surface makes of it: up to 30 degrees as seen from where the tool is, or 5 mm.

    Parameters
    ----------
    points
        Of the path.
    start
        Where the tool is.
    columns
        Of N by the name of the contact or couple, normals INTO the surfaces, shape (6,).

    Raises
    ------
    CommandError
        That names the first such point, from 0 on, and the contacts.

    """
    if not columns:
        return
    N = np.array(list(columns.values()))
    normals = N[N[:, :3].any(axis=1), :3]
    inwards = normals.sum(axis=0)
    ways = points.positions_world - start.position_world
    placed = ways @ np.linalg.pinv(normals) @ normals
    distances = np.linalg.norm(ways, axis=1)
    depths = np.linalg.norm(placed, axis=1)
    for index, (distance, depth) in enumerate(zip(distances.tolist(), depths.tolist())):
        if depth > max(SURFACE_DISTANCE, LARGEST_SINE * distance):
            direction = 'through' if placed[index] @ inwards > 0.0 else 'off'
            angle = math.degrees(math.asin(min(1.0, depth / distance)))
            raise CommandError(
                f'point {index}',
                f'at most {math.degrees(math.asin(LARGEST_SINE)):.0f} degrees or '
                f'{1e3 * SURFACE_DISTANCE:g} mm out of the surfaces of {", ".join(columns)}',
                f'{angle:.0f} degrees, {1e3 * depth:.3g} mm {direction} them',
                hint='there the contacts place the tool until they are let go (0 N)',
            )
