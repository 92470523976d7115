"""
What the bar tips meet: compliant, one-sided, rough surfaces with friction.

Forces are what the robot does to the surface, and normals point into it, so a pressing force has a
positive normal component.
"""

from __future__ import annotations

from dataclasses import dataclass

from multicontact_control.arrays import Matrix, Vector
from multicontact_control.compiled import compiled
import numpy as np
from sim_bridge.config import SurfaceConfig

PROFILE_POINTS = 1 << 16
POINTS_PER_LENGTH = 5

# Columns of `Surfaces.parameters`.
STIFFNESS, DAMPING, FRICTION, SLIP_SPEED, SPACING = range(5)


@dataclass(frozen=True, slots=True)
class Surfaces:
    """
    Several surfaces as arrays, one row each.

    Attributes
    ----------
    points_world
        A point of each mean surface, shape (nc, 3) [m].
    normals_world
        Unit normals INTO the surfaces, shape (nc, 3).
    tracks_world
        Unit directions along which the height profiles run, shape (nc, 3).
    parameters, heights, slopes
        Stiffness [N/m], damping [N s/m], friction, slip speed [m/s], profile spacing [m],
        shape (nc, 5); height profiles, positive towards the robot, shape (nc, m) [m], each of
        which repeats after its last point; their derivatives along the track, shape (nc, m).

    """

    points_world: Matrix
    normals_world: Matrix
    tracks_world: Matrix
    parameters: Matrix
    heights: Matrix
    slopes: Matrix


def build_surfaces(
    configs: list[SurfaceConfig], generators: list[np.random.Generator],
) -> Surfaces:
    """
    Lay out surfaces, each with a roughness of its own.

    Parameters
    ----------
    configs
        The surfaces, in the order of the contacts.
    generators
        A source of randomness for each.

    Returns
    -------
    Surfaces
        Their arrays.

    """
    heights = np.zeros((len(configs), PROFILE_POINTS))
    slopes = np.zeros_like(heights)
    rows = np.zeros((len(configs), 5))
    for i, config in enumerate(configs):
        spacing = config.roughness_length / POINTS_PER_LENGTH
        heights[i] = roughness_profile(config.roughness_std, generators[i])
        slopes[i] = (np.roll(heights[i], -1) - np.roll(heights[i], 1)) / (2.0 * spacing)
        rows[i] = (
            config.stiffness, config.damping, config.friction, config.slip_speed, spacing)
    normals = np.array([config.normal_world for config in configs]).reshape(-1, 3)
    return Surfaces(
        points_world=np.array([config.point_world for config in configs]).reshape(-1, 3),
        normals_world=normals,
        tracks_world=np.array([track_direction(normal) for normal in normals]).reshape(-1, 3),
        parameters=rows, heights=heights, slopes=slopes)


def roughness_profile(std: float, generator: np.random.Generator) -> Vector:
    """
    Return a periodic height profile: white noise smoothed by a Gaussian.

    The Gaussian's standard deviation L is `POINTS_PER_LENGTH` points, so that the heights
    correlate as exp(-(d / 2 L)^2).

    Parameters
    ----------
    std
        Standard deviation of the heights [m].
    generator
        Source of randomness.

    Returns
    -------
    Vector
        Heights, shape (PROFILE_POINTS,) [m], of mean 0 and exactly the standard deviation asked.

    """
    white = generator.standard_normal(PROFILE_POINTS)
    frequency = np.fft.rfftfreq(PROFILE_POINTS)
    response = np.exp(-0.5 * (2.0 * np.pi * frequency * POINTS_PER_LENGTH) ** 2)
    response[0] = 0.0
    smooth: Vector = np.fft.irfft(np.fft.rfft(white) * response, PROFILE_POINTS)
    return smooth * (std / np.std(smooth))


def track_direction(normal_world: Vector) -> Vector:
    """
    Return the direction in a surface along which its height varies.

    It is world x laid into the surface, or world y for a surface that faces along x.
    """
    axis = np.array([1.0, 0.0, 0.0])
    if abs(normal_world[0]) > 0.9:
        axis = np.array([0.0, 1.0, 0.0])
    along = axis - normal_world * (normal_world @ axis)
    return np.asarray(along / np.linalg.norm(along))


@compiled
def profile_at(values: Vector, spacing: float, position: float) -> float:
    """Return the value of a periodic profile at a position along its track, between points."""
    place = position / spacing
    lower = np.floor(place)
    share = place - lower
    index = int(lower) % values.shape[0]
    following = (index + 1) % values.shape[0]
    return float((1.0 - share) * values[index] + share * values[following])


@compiled
def contact_force(
    point: Vector, velocity: Vector, surface_point: Vector, normal: Vector, track: Vector,
    parameters: Vector, heights: Vector, slopes: Vector, force: Vector,
) -> float:
    """
    Fill `force` with what a moving point does to a surface, and return its normal component.

    alpha = max(0, k depth + c d(depth)/dt) inside the surface, 0 outside (Kelvin-Voigt, it never
    pulls); friction mu alpha v / sqrt(|v|^2 + v_s^2) along the sliding velocity v.

    Parameters
    ----------
    point, velocity
        Of the tip, world axes, shape (3,) [m], [m/s].
    surface_point, normal, track
        Row of `Surfaces`, shape (3,).
    parameters, heights, slopes
        Row of `Surfaces`.
    force
        Filled with the force on the surface, world axes, shape (3,) [N].

    Returns
    -------
    float
        The normal force alpha [N].

    """
    depth = 0.0
    rate = 0.0
    along = 0.0
    along_rate = 0.0
    for i in range(3):
        offset = point[i] - surface_point[i]
        depth += offset * normal[i]
        rate += velocity[i] * normal[i]
        along += offset * track[i]
        along_rate += velocity[i] * track[i]
    normal_speed = rate
    depth += profile_at(heights, parameters[SPACING], along)
    rate += profile_at(slopes, parameters[SPACING], along) * along_rate
    force[0], force[1], force[2] = 0.0, 0.0, 0.0
    if depth <= 0.0:
        return 0.0
    alpha = max(0.0, parameters[STIFFNESS] * depth + parameters[DAMPING] * rate)
    speed_squared = parameters[SLIP_SPEED] ** 2
    for i in range(3):
        speed_squared += (velocity[i] - normal_speed * normal[i]) ** 2
    friction = parameters[FRICTION] * alpha / np.sqrt(speed_squared)
    for i in range(3):
        force[i] = alpha * normal[i] + friction * (velocity[i] - normal_speed * normal[i])
    return float(alpha)
