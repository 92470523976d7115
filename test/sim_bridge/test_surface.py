"""What is felt of a surface, and what is seen of it."""

from multicontact_control.runs.scenario import resolve
import numpy as np
from numpy.testing import assert_allclose
import pytest
from sim_bridge.config import SurfaceConfig
from sim_bridge.surface import (
    build_surfaces,
    POINTS_PER_LENGTH,
    press_surface,
    roughness_profile,
)
from sim_bridge.surface_patch import SurfaceMarkers

NORMAL = np.array([0.0, 0.6, -0.8])


def surface(**changes):
    values = {
        'tip_link': 'tip',
        'point_world': (0.1, 0.2, 0.3),
        'normal_world': tuple(NORMAL),
        'roughness_std': 0.0,
    }
    config = SurfaceConfig(**{**values, **changes})
    return build_surfaces([config], [np.random.default_rng(1)])


def touch(surfaces, depth, velocity=(0.0, 0.0, 0.0), along=0.0):
    """Press a tip into a surface; return alpha [N] and the force, shape (3,) [N]."""
    (record,), (profile,) = surfaces
    record['point'] = record['place'] + depth * NORMAL + along * record['track']
    record['force'] = np.nan
    press_surface(record, np.array(velocity, dtype=float), profile)
    return record['alpha'], record['force'].copy()


def test_contact_force_is_that_of_spring_and_damper():
    surfaces = surface()
    depths = np.linspace(1e-4, 5e-3, 20)
    forces = [touch(surfaces, depth)[0] for depth in depths]
    assert_allclose(np.polyfit(depths, forces, 1), [6000.0, 0.0], atol=1e-9)
    _, force = touch(surfaces, 1e-3)
    assert_allclose(force, 6.0 * NORMAL, atol=1e-12)


def test_damper_feels_the_speed_between_the_tip_and_a_surface_that_goes_away():
    surfaces = surface()
    surfaces[0]['speed'] = 0.02
    alpha, _ = touch(surfaces, 1e-3, 0.03 * NORMAL)
    assert alpha == pytest.approx(6000.0 * 1e-3 + 30.0 * 0.01)


@pytest.mark.parametrize(('depth', 'speed'), [(-1e-6, 0.0), (-1e-3, 1.0), (1e-4, -1.0)])
def test_surface_never_pulls(depth, speed):
    """Neither out of reach nor on a tip that leaves faster than the spring."""
    alpha, force = touch(surface(), depth, speed * NORMAL)
    assert alpha == 0.0
    assert not force.any()


def test_friction_stays_in_its_cone_and_along_the_sliding(rng):
    surfaces = surface(friction=0.3)
    for _ in range(100):
        velocity = 10 ** rng.uniform(-5, 0) * rng.standard_normal(3)
        alpha, force = touch(surfaces, 5e-3, velocity)
        sliding = velocity - (NORMAL @ velocity) * NORMAL
        friction = force - alpha * NORMAL
        assert np.linalg.norm(friction) <= 0.3 * alpha
        assert_allclose(np.cross(friction, sliding), 0.0, atol=1e-12)
        assert friction @ sliding >= 0.0


def test_friction_of_a_fast_slide_is_coulombs():
    alpha, force = touch(surface(friction=0.3), 1e-3, (0.5, 0.0, 0.0))
    assert force[0] == pytest.approx(0.3 * alpha, rel=1e-4)


def test_roughness_has_the_asked_deviation_and_correlation_length():
    """Autocorrelation exp(-(d / 2 L)^2): 1/e at twice the kernel's length."""
    profile = roughness_profile(4e-5, np.random.default_rng(3))
    assert np.std(profile) == pytest.approx(4e-5, rel=1e-12)
    assert np.mean(profile) == pytest.approx(0.0, abs=1e-12)
    for lengths in (1, 2):
        shifted = np.roll(profile, lengths * POINTS_PER_LENGTH)
        correlation = np.mean(profile * shifted) / np.var(profile)
        expected = np.exp(-((lengths / 2.0) ** 2))
        assert correlation == pytest.approx(expected, abs=0.03)


def test_roughness_is_felt_as_depth_and_as_rate():
    surfaces = surface(roughness_std=4e-5)
    (record,), ((heights, slopes),) = surfaces
    spacing = record['spacing']
    for point in (0, 17, -5):
        height = heights[point]
        slope = slopes[point]
        rise = heights[point + 1] - heights[point - 1]
        assert slope == pytest.approx(rise / (2.0 * spacing))
        along = point * spacing
        alpha, _ = touch(surfaces, 1e-3, along=along)
        assert alpha == pytest.approx(6000.0 * (1e-3 + height), rel=1e-9)
        moving, _ = touch(surfaces, 1e-3, 0.1 * record['track'], along)
        assert moving - alpha == pytest.approx(30.0 * 0.1 * slope, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize('shape', ['cylinder', 'sphere'])
@pytest.mark.parametrize('radius', [0.5, -0.5])
def test_curved_surface_is_pressed_towards_its_centre_or_axis(shape, radius, rng):
    (record,), (profile,) = surface(
        shape=shape, radius=radius, friction=0.0, damping=0.0
    )
    place = record['place'].copy()
    track = record['track'].copy()
    axis = np.cross(NORMAL, track)
    centre = place + radius * NORMAL
    for _ in range(20):
        way = rng.uniform([-0.1, -0.1, -0.01], [0.1, 0.1, 0.05])
        record['point'] = place + way @ [track, axis, NORMAL]
        press_surface(record, np.zeros(3), profile)
        inwards = centre - record['point']
        if shape == 'cylinder':
            inwards -= (inwards @ axis) * axis
        distance = np.linalg.norm(inwards)
        side = np.sign(radius)
        depth = max(0.0, radius - side * distance)
        expected = 6000.0 * depth * side * inwards / distance
        assert_allclose(record['force'], expected, atol=1e-9)


@pytest.mark.parametrize(
    ('scenario', 'names', 'shown'),
    [('plane', ['face'], 0), ('moving_surface', ['table', 'board'], 25)],
)
def test_markers_show_a_slab_for_each_contact_where_it_is(scenario, names, shown):
    config = resolve(scenario, plant='rigid').plant
    markers = SurfaceMarkers(config, rate=500.0)
    due = [markers.is_due(tick) for tick in range(1, 501)]
    assert sum(due) == shown
    places = np.arange(3.0 * len(config.met)).reshape(-1, 3)
    message = markers.build_message(1_500_000_000, places)
    for marker, name in zip(message.markers, names):
        assert marker.ns.endswith(f'/{name}')
    for marker, name in zip(message.markers, config.drawn.values()):
        at = marker.pose.position
        assert [at.x, at.y, at.z] == places[config.met.index(name)].tolist()
