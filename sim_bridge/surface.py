"""
Surfaces that the bar tips meet: compliant, one-sided, rough, with friction, curved or moving.

Forces are what the robot does to the surface, and normals point into it, so a pressing force has a
positive normal component.
"""

from __future__ import annotations

from typing import Annotated, Protocol

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
from multicontact_control.records import (
    Record,
    record_dtype,
    Records,
)
import numpy as np
from sim_bridge.config import SurfaceConfig

PROFILE_POINTS = 1 << 16
POINTS_PER_LENGTH = 5


class Surface(Record, Protocol):
    """One surface, the tip that may touch it, and what is between them; world axes."""

    place: Annotated[Vector, 3]  # a point of the mean surface [m]
    normal: Annotated[Vector, 3]  # unit normal INTO the surface
    track: Annotated[Vector, 3]  # unit direction along which the height profile runs
    axis: Annotated[Vector, 3]  # of a cylinder: normal x track
    stiffness: float  # [N/m]
    damping: float  # [N s/m]
    friction: float  # coefficient
    slip_speed: float  # [m/s]
    spacing: float  # of the points of the profile [m]
    joint: int  # number of the joint that carries the tip
    body: int  # number of the joint behind which the pushed link is, or n for the tool
    tip: Annotated[Vector, 3]  # the tip in that joint's frame [m]
    radius: float  # of a curved one, 0 for a plane, > 0 for the outside of a ball [m]
    ball: int  # whether curved all around, as a ball, or along the track alone
    velocity: float  # largest, along its normal, away from the robot [m/s]
    motion_start: float  # [s]
    motion_period: float  # 0 for a constant velocity [s]
    time: float  # of a surface that moves [s]
    speed: float  # now, along its normal, away from the robot [m/s]
    facing: Annotated[Vector, 3]  # unit normal INTO the surface where the tip is
    point: Annotated[Vector, 3]  # where the tip is [m]
    alpha: float  # normal force of robot on surface [N]
    force: Annotated[Vector, 3]  # force of robot on surface, friction included [N]


SURFACE = record_dtype(Surface)


# Fields that configuration and record have in common.
COPIED_FIELDS = [
    name for name in SurfaceConfig.model_fields if name in Surface.__annotations__
]


def build_surfaces(
    configs: list[SurfaceConfig],
    generators: list[np.random.Generator],
) -> tuple[Records[Surface], Matrix]:
    """
    Return surfaces as the compiled code works on them, each with a roughness of its own.

    Parameters
    ----------
    configs
        The surfaces, `no` of them.
    generators
        Random numbers of each one's roughness.

    Returns
    -------
    surfaces
        Records of `SURFACE`, shape (no,); the tips are not filled in.
    profiles
        Heights, positive towards the robot [m], and their derivatives along the track, shape
        (no, 2, PROFILE_POINTS). They repeat after the last point.

    """
    profiles = np.zeros((len(configs), 2, PROFILE_POINTS))
    surfaces = np.zeros(len(configs), dtype=SURFACE)
    for surface, profile, config, generator in zip(
        surfaces, profiles, configs, generators
    ):
        for name in COPIED_FIELDS:
            surface[name] = getattr(config, name)
        normal = np.array(config.normal_world)
        track = track_direction(normal)
        surface['place'] = config.point_world
        surface['normal'] = normal
        surface['facing'] = normal
        surface['track'] = track
        surface['axis'] = np.cross(normal, track)
        surface['ball'] = config.shape == 'sphere'
        spacing = config.roughness_length / POINTS_PER_LENGTH
        surface['spacing'] = spacing
        heights = roughness_profile(config.roughness_std, generator)
        profile[0] = heights
        profile[1] = (np.roll(heights, -1) - np.roll(heights, 1)) / (2.0 * spacing)
    return surfaces, profiles


def roughness_profile(std: float, generator: np.random.Generator) -> Vector:
    """
    Return a periodic height profile: white noise smoothed by a Gaussian.

    The Gaussian's standard deviation L is `POINTS_PER_LENGTH` points, so that heights at a
    distance d correlate as exp(-(d / 2 L)^2).

    Parameters
    ----------
    std
        Standard deviation of the heights [m], which they have exactly, with mean 0.
    generator
        Of the white noise.

    Returns
    -------
    Vector
        Heights, shape (PROFILE_POINTS,) [m].

    """
    white = generator.standard_normal(PROFILE_POINTS)
    frequency = np.fft.rfftfreq(PROFILE_POINTS)
    response = np.exp(-0.5 * (2.0 * np.pi * frequency * POINTS_PER_LENGTH) ** 2)
    response[0] = 0.0
    smooth: Vector = np.fft.irfft(np.fft.rfft(white) * response, PROFILE_POINTS)
    return smooth * (std / np.std(smooth))


def track_direction(normal_world: Vector) -> Vector:
    """
    Return the unit direction in a surface along which its height varies, shape (3,).

    It is world x laid into the surface, or world y for a surface that faces along x. The normal
    is a unit vector, world axes, shape (3,).
    """
    along = np.array([1.0, 0.0, 0.0])
    if abs(normal_world[0]) > 0.9:
        along = np.array([0.0, 1.0, 0.0])
    track = along - normal_world * (normal_world @ along)
    return np.asarray(track / np.linalg.norm(track))


@compiled
def move_surface(surface: Surface, step: float) -> None:
    """
    Let a surface, a record of `SURFACE`, move along its normal for a step [s].

    With a constant velocity, or with v sin(2 pi t / T), from `motion_start` on.
    """
    surface.time += step
    time = surface.time - surface.motion_start
    surface.speed = surface.velocity
    if time <= 0.0:
        surface.speed = 0.0
    if surface.motion_period > 0.0:
        surface.speed *= np.sin(2.0 * np.pi * time / surface.motion_period)
    distance = surface.speed * step
    for i in range(3):
        surface.place[i] += distance * surface.normal[i]


@compiled
def measure_depth(surface: Surface) -> float:
    """
    Return how deep the tip is in the mean surface [m], and fill in which way that faces.

    Of a record of `SURFACE` whose point is filled in. On a curved one, depth and normal are those
    towards its centre (a sphere) or its axis (a cylinder).
    """
    normal = surface.normal
    facing = surface.facing
    depth = 0.0
    for i in range(3):
        facing[i] = normal[i]
        depth += (surface.point[i] - surface.place[i]) * normal[i]
    if surface.radius == 0.0:
        return depth
    away = np.empty(3)
    across = 0.0
    for i in range(3):
        away[i] = surface.place[i] + surface.radius * normal[i] - surface.point[i]
        across += away[i] * surface.axis[i]
    squared = 0.0
    for i in range(3):
        if not surface.ball:
            away[i] -= across * surface.axis[i]
        squared += away[i] * away[i]
    distance = np.sqrt(squared)
    sign = -1.0
    if surface.radius > 0.0:
        sign = 1.0
    if distance > 0.0:
        for i in range(3):
            facing[i] = sign * away[i] / distance
    return float(surface.radius - sign * distance)


@compiled
def press_surface(surface: Surface, velocity: Vector, profile: Matrix) -> None:
    """
    Work out what a moving tip does to a surface.

    Normal force alpha = max(0, k depth + c d(depth)/dt) inside the surface, 0 outside
    (Kelvin-Voigt, it never pulls); friction mu alpha v / sqrt(|v|^2 + v_s^2) along the sliding
    velocity v.

    Parameters
    ----------
    surface
        A record of `SURFACE` with the point filled in; force and alpha are filled in here.
    velocity
        Of the tip, world axes, shape (3,) [m/s].
    profile
        Heights of the surface [m] and their derivative along the track, shape (2, m).

    """
    normal = surface.facing
    track = surface.track
    force = surface.force
    along = 0.0
    for i in range(3):
        along += (surface.point[i] - surface.place[i]) * track[i]
    depth = measure_depth(surface)
    rate = 0.0
    along_rate = 0.0
    for i in range(3):
        rate += velocity[i] * normal[i]
        along_rate += velocity[i] * track[i]
    normal_speed = rate
    # A surface that moves goes along its own normal, not along that where the tip is.
    for i in range(3):
        rate -= surface.speed * surface.normal[i] * normal[i]
    # The height of the profile there, between two of its points.
    lower = np.floor(along / surface.spacing)
    share = along / surface.spacing - lower
    index = int(lower) % profile.shape[1]
    following = (index + 1) % profile.shape[1]
    depth += (1.0 - share) * profile[0, index] + share * profile[0, following]
    slope = (1.0 - share) * profile[1, index] + share * profile[1, following]
    rate += slope * along_rate
    for i in range(3):
        force[i] = 0.0
    surface.alpha = 0.0
    if depth <= 0.0:
        return
    surface.alpha = max(0.0, surface.stiffness * depth + surface.damping * rate)
    speed_squared = surface.slip_speed**2
    for i in range(3):
        speed_squared += (velocity[i] - normal_speed * normal[i]) ** 2
    friction = surface.friction * surface.alpha / np.sqrt(speed_squared)
    for i in range(3):
        force[i] = surface.alpha * normal[i] + friction * (
            velocity[i] - normal_speed * normal[i]
        )
