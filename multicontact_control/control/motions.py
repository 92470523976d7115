"""The motions that a scenario may have: along a sine, round a circle, through waypoints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import csv
import math
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol

from multicontact_control.algebra import quintic_blend
from multicontact_control.arrays import Matrix, Vector
from multicontact_control.config import (
    Config,
    ControllerConfig,
    LimitsConfig,
    parameter,
    UnitVector3,
)
from multicontact_control.config.base import Vector as Numbers
from multicontact_control.control.trajectory import (
    RampedTime,
    shortest_motion_duration,
    Trajectory,
)
from multicontact_control.control.trajectory_checks import (
    check_points,
    check_surfaces,
    LARGEST_SINE,
    TimedPoses,
)
from multicontact_control.dynamics.rotations import Pose
from multicontact_control.errors import CommandError, ConfigError
import numpy as np
from pydantic import Discriminator, Tag

LARGEST_COSINE = 1e-3  # of the angle between directions that are to be at right angles
COLUMNS = {'x', 'y', 'z'}, {'u', 'v'}  # of the positions in a file of waypoints
OTHER_COLUMNS = {'speed', 'force'}
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])  # no turn, as a quaternion


class SineConfig(Config):
    """A sinusoid of the operational point along one direction, blended in by a quintic."""

    kind: Literal['sine'] = parameter('sine', 'Which motion it is.')
    start_time: float = parameter(..., 'When the motion starts.', unit='s', ge=0.0)
    direction_world: UnitVector3 = parameter(
        (1.0, 0.0, 0.0), 'Unit direction, world axes.'
    )
    amplitude: float = parameter(0.15, 'Amplitude.', unit='m', ge=0.0)
    period: float = parameter(8.0, 'Period.', unit='s', gt=0.0)
    blend_time: float = parameter(
        2.0, 'Duration of the quintic blend-in.', unit='s', gt=0.0
    )


class CircleConfig(Config):
    """A circle of the operational point, which begins and ends at rest where the tool stands."""

    kind: Literal['circle'] = parameter('circle', 'Which motion it is.')
    start_time: float = parameter(..., 'When the motion starts.', unit='s', ge=0.0)
    radius: float = parameter(0.07, 'Radius.', unit='m', gt=0.0)
    speed: float = parameter(
        0.1, 'Speed along it, less where the limits ask for it.', unit='m/s', gt=0.0
    )
    turns: float = parameter(2.0, 'How often it is gone round.', gt=0.0)
    centre_direction_world: UnitVector3 = parameter(
        (1.0, 0.0, 0.0), 'From the tool to the centre at the start, world axes.'
    )
    direction_world: UnitVector3 = parameter(
        (0.0, 1.0, 0.0),
        'Of the motion at the start, at right angles to that, world axes.',
    )
    blend_time: float = parameter(
        1.0, 'In which the angle begins to turn, and ends.', unit='s', gt=0.0
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        cosine = float(np.dot(self.centre_direction_world, self.direction_world))
        if abs(cosine) > LARGEST_COSINE:
            yield ConfigError(
                'reference.motion.direction_world',
                'a direction at right angles to centre_direction_world',
                f'{math.degrees(math.acos(cosine)):.1f} degrees from it',
            )
        path_time = 2.0 * math.pi * self.radius * self.turns / self.speed
        if self.blend_time > path_time:
            yield ConfigError(
                'reference.motion.blend_time',
                f'at most the {path_time:.3g} s that the turns take at this speed',
                f'{self.blend_time:g} s',
            )


class WaypointConfig(Config):
    """A waypoint: three coordinates in the world, or two along the surface of a contact."""

    position: Numbers = parameter(
        ...,
        'World axes, or u and v from the tool.',
        unit='m',
        min_length=2,
        max_length=3,
    )
    speed: float | None = parameter(
        None, 'On the way to it instead of that of all.', unit='m/s', gt=0.0
    )
    force: float | None = parameter(
        None, 'Desired force of the contact from there on.', unit='N', ge=0.0
    )


class WaypointsConfig(Config):
    """
    A path through waypoints, which begins and ends at rest.

    The axis u is world x laid into the surface, or world y for one that faces along x; v is at
    right angles, counter-clockwise for one who looks at the surface.
    """

    kind: Literal['waypoints'] = parameter('waypoints', 'Which motion it is.')
    start_time: float = parameter(
        ..., 'When the tool starts for the first waypoint.', unit='s', ge=0.0
    )
    lead_time: float = parameter(
        2.0, 'In which it is there, where the path begins.', unit='s', gt=0.0
    )
    file: str = parameter(
        '',
        'CSV file beside that of the scenario with the columns x, y, z in world axes, or u, v '
        'along the surface [m], and those of speed and force if they change. Its rows take the '
        'place of points.',
    )
    points: tuple[WaypointConfig, ...] = ()
    speed: float = parameter(
        0.05, 'Between waypoints, less where the limits ask for it.', unit='m/s', gt=0.0
    )
    contact: str = parameter(
        '', 'Contact that the forces are for, and whose surface has the axes u and v.'
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        if len(self.points) < 2:
            yield ConfigError(
                'reference.motion.points', 'at least 2, or a file', len(self.points)
            )
            return
        for index, point in enumerate(self.points):
            before = self.points[max(index - 1, 0)]
            place = f'reference.motion.points.{index}'
            if len(point.position) != len(before.position):
                yield ConfigError(
                    f'{place}.position',
                    f'{len(before.position)} coordinates as before',
                    len(point.position),
                )
            elif index and point.position == before.position:
                yield ConfigError(
                    f'{place}.position', 'another than before', 'the same'
                )
        uses_contact = len(self.points[0].position) == 2 or any(
            point.force is not None for point in self.points
        )
        if uses_contact and not self.contact:
            yield ConfigError(
                'reference.motion.contact',
                'the contact of these surface or forces',
                "''",
            )


def _name_motion_kind(motion: Any) -> str:
    """Return the kind of a motion, as values or made; a sine if it names none."""
    if isinstance(motion, Mapping):
        return str(motion.get('kind', 'sine'))
    return str(getattr(motion, 'kind', 'sine'))


MotionConfig = Annotated[
    Annotated[SineConfig, Tag('sine')]
    | Annotated[CircleConfig, Tag('circle')]
    | Annotated[WaypointsConfig, Tag('waypoints')],
    Discriminator(_name_motion_kind),
]


def with_waypoints_of_file(
    reference: Mapping[str, Any], folder: Path
) -> dict[str, Any]:
    """
    Return the values of a reference, with the rows of a file of waypoints as its points.

    A relative path starts at `folder`. ConfigError if the file cannot be read, or its columns are
    none of waypoints; `WaypointsConfig` checks the numbers.
    """
    values = dict(reference)
    motion = values.get('motion')
    if isinstance(motion, Mapping) and motion.get('file'):
        name = str(motion['file'])
        others = {key: value for key, value in motion.items() if key != 'file'}
        values['motion'] = {**others, 'points': read_waypoints(folder / name)}
    return values


def read_waypoints(path: Path) -> list[dict[str, Any]]:
    """
    Return the rows of a CSV file of waypoints as values of `WaypointConfig`.

    Lines that begin with # are comments. ConfigError, with the line, for a file that cannot be
    read, other columns than those of `WaypointsConfig`, and what is no number.
    """
    try:
        with path.open(encoding='utf-8', newline='') as file:
            lines = [line for line in file if line.strip() and not line.startswith('#')]
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            str(path), 'a CSV file of waypoints', hint=str(error)
        ) from None
    reader = csv.DictReader(lines, skipinitialspace=True)
    names = [name.strip() for name in reader.fieldnames or []]
    reader.fieldnames = names
    axes = [name for name in names if name not in OTHER_COLUMNS]
    if set(axes) not in COLUMNS or len(set(names)) != len(names):
        raise ConfigError(
            str(path),
            'columns x, y, z or u, v, and speed and force if wanted',
            ', '.join(names),
        )
    points = []
    for index, row in enumerate(reader):
        numbers = {}
        for name in names:
            text = (row[name] or '').strip()
            if not text and name in OTHER_COLUMNS:
                continue  # as before it
            try:
                numbers[name] = float(text)
            except ValueError:
                raise ConfigError(
                    f'{path}: point {index}: {name}', 'a number', repr(text)
                ) from None
        position = [numbers.pop(name) for name in sorted(axes)]
        points.append({'position': position, **numbers})
    return points


class PlannedMotion(Protocol):
    """
    A motion of a scenario, as a displacement of the operational point in world axes.

    Attributes
    ----------
    end
        When it is at rest for ever [s].
    force_steps
        Time [s], contact and force [N] of each step that belongs to it.

    """

    end: float
    force_steps: list[tuple[float, str, float]]

    def start(self, position_world: Vector, normals: Mapping[str, Vector]) -> None:
        """Begin from a position [m], beside normals INTO the surfaces by contact, world axes."""

    def displace(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Return displacement (3,) [m], twist and acceleration (6,) at a time after its start."""


class SineMotion:
    """A sinusoid along a direction."""

    def __init__(self, config: SineConfig) -> None:
        self._config = config
        self.end = math.inf
        self.force_steps: list[tuple[float, str, float]] = []
        self._direction = np.zeros(6)  # as a twist
        self._direction[:3] = config.direction_world

    def start(self, position_world: Vector, normals: Mapping[str, Vector]) -> None:
        """Begin; it has no memory."""

    def displace(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Return displacement, twist and acceleration; see `PlannedMotion.displace`."""
        s, ds, dds = evaluate_sine_motion(self._config, time)
        direction = self._direction
        return s * direction[:3], ds * direction, dds * direction


class CircleMotion:
    """
    A circle of radius r, from where the tool stands.

    r ((1 - cos a) c + sin a d), with c towards the centre, d along the first motion, and an angle
    a whose speed is ramped at both ends. The speed is less than asked for where the limits of
    speed, or of acceleration v^2 / r, ask for it.
    """

    def __init__(self, config: CircleConfig, limits: LimitsConfig) -> None:
        self._start_time = config.start_time
        self._radius = config.radius
        self._plane = np.zeros((2, 6))
        self._plane[:, :3] = config.centre_direction_world, config.direction_world
        speed = min(
            config.speed,
            limits.operational_speed,
            math.sqrt(limits.operational_acceleration * config.radius),
        )
        self._angular_speed = speed / config.radius
        length = 2.0 * math.pi * config.turns / self._angular_speed
        self._clock = RampedTime(length, config.blend_time, config.blend_time)
        self.end = config.start_time + self._clock.duration
        self.force_steps: list[tuple[float, str, float]] = []

    def start(self, position_world: Vector, normals: Mapping[str, Vector]) -> None:
        """Begin; it has no memory."""

    def displace(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Return displacement, twist and acceleration; see `PlannedMotion.displace`."""
        path_time, rate, change = self._clock.advance(time - self._start_time)
        angle = self._angular_speed * path_time
        turning = self._angular_speed * rate
        turning_change = self._angular_speed * change
        r = self._radius
        sine = math.sin(angle)
        cosine = math.cos(angle)
        centre, along = self._plane
        outwards = cosine * centre - sine * along  # d^2 / da^2, over r
        tangent = sine * centre + cosine * along
        place = r * ((1.0 - cosine) * centre[:3] + sine * along[:3])
        acceleration = r * (turning_change * tangent + turning**2 * outwards)
        return place, r * turning * tangent, acceleration


class WaypointsMotion:
    """
    A path through waypoints, which a quintic leads to; see `Trajectory`.

    ConfigError if the waypoints are not within the workspace box.
    """

    def __init__(self, config: WaypointsConfig, limits: LimitsConfig) -> None:
        self._config = config
        self._in_world = len(config.points[0].position) == 3
        self._limits = limits
        self._path_time = config.start_time + config.lead_time
        places = np.zeros((len(config.points), 3))
        for place, point in zip(places, config.points):
            place[: len(point.position)] = point.position
        speeds = [point.speed or config.speed for point in config.points]
        distances = np.linalg.norm(np.diff(places, axis=0), axis=1)
        times = np.concatenate([[0.0], np.cumsum(distances / speeds[1:])])
        self.points = TimedPoses(times, places, np.tile(UPRIGHT, (len(places), 1)))
        if not self._in_world:
            limits = limits.model_copy(
                update={'workspace_lower': (), 'workspace_upper': ()}
            )
        try:
            check_points(self.points, limits)
            self._trajectory = Trajectory(
                Pose(places[0], np.eye(3)), self.points, limits
            )
        except CommandError as error:
            raise error.as_config_error(f'reference.motion: {error.field}') from None
        self.end = self._path_time + self._trajectory.duration
        self.force_steps = [
            (self._path_time + time, config.contact, point.force)
            for time, point in zip(
                self._trajectory.passing_times.tolist(), config.points
            )
            if point.force is not None
        ]
        self.start(np.zeros(3), {})

    def start(self, position_world: Vector, normals: Mapping[str, Vector]) -> None:
        """
        Begin from a position; see `PlannedMotion.start`.

        ConfigError if the first waypoint cannot be reached in time within the limits.
        """
        self._axes = np.eye(3)
        # From which the coordinates count, relative to the tool.
        self._origin = np.zeros(3)
        if self._in_world:
            self._origin = -position_world
        elif self._config.contact in normals:
            self._axes = surface_axes(normals[self._config.contact])
        way = np.zeros(6)
        way[:3] = self._origin + self.points.positions_world[0] @ self._axes
        self._lead_in = way
        shortest = shortest_motion_duration(way, self._limits)
        if normals and shortest > self._config.lead_time:
            raise ConfigError(
                'reference.motion.lead_time',
                f'at least {shortest:.3g} s for the {np.linalg.norm(way):.3g} m to the first '
                'waypoint',
                f'{self._config.lead_time:g} s',
            )

    def displace(self, time: float) -> tuple[Vector, Vector, Vector]:
        """Return displacement, twist and acceleration; see `PlannedMotion.displace`."""
        since_path = time - self._path_time
        if since_path < 0.0:
            lead_time = self._config.lead_time
            b, db, ddb = quintic_blend(since_path + lead_time, lead_time)
            return b * self._lead_in[:3], db * self._lead_in, ddb * self._lead_in
        state = self._trajectory.evaluate(since_path)
        twist = np.zeros(6)
        acceleration = np.zeros(6)
        twist[:3] = state.twist_world[:3] @ self._axes
        acceleration[:3] = state.acceleration_world[:3] @ self._axes
        place = self._origin + state.pose.position_world @ self._axes
        return place, twist, acceleration


def surface_axes(normal_world: Vector) -> Matrix:
    """
    Return the axes u, v and the outer normal of a surface as rows, shape (3, 3).

    `normal_world` points INTO it. The axis u is world x laid into the surface, or world y for one
    that faces along x.
    """
    outwards = -normal_world / np.linalg.norm(normal_world)
    laid = np.array([1.0, 0.0, 0.0])
    if abs(outwards[0]) > math.cos(math.radians(20.0)):
        laid = np.array([0.0, 1.0, 0.0])
    u = laid - (laid @ outwards) * outwards
    u /= np.linalg.norm(u)
    return np.array([u, np.cross(outwards, u), outwards])


def plan_motion(
    config: SineConfig | CircleConfig | WaypointsConfig, limits: LimitsConfig
) -> PlannedMotion:
    """Return the motion of a configuration, within the limits of the operational point."""
    if isinstance(config, SineConfig):
        return SineMotion(config)
    if isinstance(config, CircleConfig):
        return CircleMotion(config, limits)
    return WaypointsMotion(config, limits)


def require_free_motion(
    config: SineConfig | CircleConfig | WaypointsConfig,
    controller: ControllerConfig,
    pressed: list[str],
) -> None:
    """Refuse, by ConfigError, a motion into or out of surfaces that are `pressed` meanwhile."""
    if isinstance(config, SineConfig) and config.amplitude == 0.0:
        return
    normals = np.array([controller.contacts[name].normal_world for name in pressed])
    normals = normals.reshape(-1, 3)  # also of none
    if isinstance(config, WaypointsConfig):
        if len(config.points[0].position) == 2:
            return
        points = WaypointsMotion(config, controller.limits).points
        columns = {name: np.append(n, np.zeros(3)) for name, n in zip(pressed, normals)}
        first = Pose(points.positions_world[0], np.eye(3))
        try:
            check_surfaces(points, first, columns)
        except CommandError as error:
            raise error.as_config_error(f'reference.motion: {error.field}') from None
        return
    directions = [config.direction_world]
    if isinstance(config, CircleConfig):
        directions.append(config.centre_direction_world)
    out_of_surfaces = np.linalg.pinv(normals) @ (normals @ np.array(directions).T)
    sine = float(np.linalg.norm(out_of_surfaces, 2))
    if sine > LARGEST_SINE:
        largest_angle = math.degrees(math.asin(LARGEST_SINE))
        angle = math.degrees(math.asin(min(sine, 1.0)))
        raise ConfigError(
            'reference.motion.direction_world',
            f'at most {largest_angle:.0f} degrees out of the surfaces '
            f'of {", ".join(pressed)}, which are pressed then',
            f'{list(config.direction_world)}, {angle:.0f} degrees out of them',
            hint='a motion has no effect along the normal of a contact',
        )


def evaluate_sine_motion(config: SineConfig, time: float) -> tuple[float, float, float]:
    """Return s = A b(tau / t_b) sin(2 pi tau / T) [m], b a quintic, and its two derivatives."""
    tau = time - config.start_time
    if tau <= 0.0:
        return 0.0, 0.0, 0.0
    w = 2.0 * math.pi / config.period
    sine = math.sin(w * tau)
    cosine = math.cos(w * tau)
    b, db, ddb = quintic_blend(tau, config.blend_time)
    A = config.amplitude
    return (
        A * b * sine,
        A * (db * sine + b * w * cosine),
        A * (ddb * sine + 2.0 * db * w * cosine - b * w * w * sine),
    )
