"""Columns of N of edges and planes, what is measured along them, and estimated normals."""

from multicontact_control.config.contact import ACROSS, ALONG, FORCE
from multicontact_control.contact.geometry import friction_coupling, normal_space
from multicontact_control.contact.surfaces import follow_surfaces
from multicontact_control.contact.wrench import CONTACT_SPACE, measure_contacts
from multicontact_control.records import CONTACT, CONTROL, FRAME
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

NORMAL = np.array([0.6, 0.0, -0.8])
POINT = np.array([0.02, -0.05, 0.2])
HALF = 0.04

SPACE = np.zeros(1, dtype=CONTACT_SPACE)[0]


def columns(kinds, *, friction=0.0, direction=(0.0, 1.0, 0.0)):
    """Return records of contacts at a point; a force alone has a normal and friction."""
    records = np.zeros(len(kinds), dtype=CONTACT)
    forces = np.array(kinds) == FORCE
    records['normal'][forces] = NORMAL
    config = records['config']
    config['kind'] = kinds
    config['direction'] = direction
    config['half_length'] = HALF
    config['point'] = POINT
    config['friction_std'][forces] = friction
    config['torsion_std'][forces] = HALF * friction
    return records


def wrench_of(force, point):
    """Return the wrench of a force at a point, about the origin of world axes."""
    return np.concatenate([force, np.cross(point, force)])


def point_column(point):
    """Return the wrench of 1 N along the normal at a point."""
    return wrench_of(NORMAL, point)


def control(wrench, *, separated=False, lever=(0.0, 0.0, 0.06)):
    """Return a record whose sensor, a lever from the operational point, reads a wrench there."""
    record = np.zeros(1, dtype=CONTROL)[0]
    record['frame']['rotation'] = np.eye(3)
    record['frame']['sensor_rotation'] = np.eye(3)
    record['frame']['sensor_position'] = lever
    record['law']['separated'] = separated
    record['law']['force_noise'] = 0.05
    record['law']['torque_noise'] = 0.004
    record['wrench'] = wrench
    record['wrench'][3:] -= np.cross(lever, wrench[:3])
    return record


ALONG_EDGE = np.array([0.0, 1.0, 0.0])
ACROSS_EDGE = np.cross(NORMAL, ALONG_EDGE)


def test_couple_column_is_a_difference_of_forces_at_both_ends():
    """Of 1 N: half a newton more at one end, half a newton less at the other."""
    turn = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    records = columns([FORCE, ALONG, ACROSS], direction=turn.T @ [0.0, 1.0, 0.0])
    records['config']['point'] = POINT @ turn
    N = normal_space(records, turn)
    assert_allclose(N[:, 0], point_column(POINT), atol=1e-15)
    for column, direction in ((1, ALONG_EDGE), (2, ACROSS_EDGE)):
        one_end = point_column(POINT + HALF * direction)
        other_end = point_column(POINT - HALF * direction)
        assert_allclose(N[:, column], 0.5 * (one_end - other_end), atol=1e-15)


def test_forces_at_both_ends_are_read_as_their_sum_and_their_difference():
    records = columns([FORCE, ALONG])
    one_end = 9.0 * point_column(POINT + HALF * ALONG_EDGE)
    other_end = 4.0 * point_column(POINT - HALF * ALONG_EDGE)
    assert measure_contacts(control(one_end + other_end), records, SPACE)
    assert_allclose(records['alpha_meas'], [13.0, 5.0], atol=1e-12)


def test_measured_forces_are_generalised_least_squares():
    """Friction and torsion of the contact count as noise, beside that of the sensor."""
    lever = np.array([0.01, 0.02, 0.06])
    wrench = np.random.default_rng(3).standard_normal(6)
    records = columns([FORCE, ALONG], friction=0.3)
    N = normal_space(records, np.eye(3))
    shift = np.eye(6)  # moves a wrench from the operational point to the sensor
    shift[3:, :3] = -np.cross(lever, np.eye(3)).T
    across = np.eye(3) - np.outer(NORMAL, NORMAL)
    T = shift @ np.vstack([across, np.cross(POINT, across.T).T])
    turn = HALF * np.concatenate([np.zeros(3), NORMAL])
    sensor_noise = np.diag([0.05**2] * 3 + [0.004**2] * 3)
    W = sensor_noise + 0.3**2 * (T @ T.T + np.outer(turn, turn))
    weight = np.linalg.inv(W)
    A = shift @ N
    expected = np.linalg.solve(A.T @ weight @ A, A.T @ weight @ shift @ wrench)
    reading = control(wrench, separated=True, lever=lever)
    assert measure_contacts(reading, records, SPACE)
    assert_allclose(records['alpha_meas'], expected, rtol=1e-9)
    residual = shift @ (wrench - N @ expected)
    friction = 0.3**2 * T.T @ weight @ residual
    assert_allclose(records['friction'][0], friction, rtol=1e-8, atol=1e-12)


def test_force_that_is_untared_is_taken_off():
    records = columns([FORCE, ALONG])
    records['untared'] = 3.0, 0.5
    assert measure_contacts(control(10.0 * point_column(POINT)), records, SPACE)
    assert_allclose(records['alpha_meas'], [7.0, -0.5], atol=1e-12)


def test_expected_friction_of_a_slide_is_taken_for_no_couple():
    """Along the sliding of the point: mu alpha v / sqrt(v^2 + v_s^2), v_s = 0.01 m/s."""
    records = columns([FORCE, ALONG])
    records['config']['friction_coefficient'] = 0.4, 0.0
    twist = np.array([0.02, 0.01, -0.03, 0.1, -0.2, 0.15])
    velocity = twist[:3] + np.cross(twist[3:], POINT)
    sliding = velocity - (velocity @ NORMAL) * NORMAL
    friction = 0.4 * 10.0 * sliding / np.sqrt(sliding @ sliding + 0.01**2)
    wrench = wrench_of(10.0 * NORMAL + friction, POINT)
    reading = control(wrench, separated=True)
    reading['frame']['twist'] = twist
    assert measure_contacts(reading, records, SPACE)
    assert_allclose(records['alpha_meas'], [10.0, 0.0], atol=1e-9)
    assert_allclose(records['friction'][0], friction, atol=1e-9)


def test_contacts_that_cannot_be_told_apart_keep_what_was_measured():
    """All or nothing: no friction of this sample beside forces of another."""
    records = columns([FORCE, FORCE], friction=0.3)
    records['config']['friction_coefficient'] = 0.2
    records['alpha_meas'] = 7.0
    records['friction'] = 1.5
    sliding = control(np.ones(6), separated=True)
    sliding['frame']['twist'][:3] = 0.0, 0.1, 0.0
    assert not measure_contacts(sliding, records, SPACE)
    assert (records['alpha_meas'] == 7.0).all()
    assert (records['friction'] == 1.5).all()


def test_friction_coupling_is_the_worst_misreading():
    records = columns([FORCE, ALONG])
    coupling = friction_coupling(records.copy(), np.eye(3))
    worst = np.zeros(2)
    for angle in np.linspace(0.0, np.pi, 721):
        friction = np.cos(angle) * ALONG_EDGE + np.sin(angle) * ACROSS_EDGE
        assert measure_contacts(control(wrench_of(friction, POINT)), records, SPACE)
        worst = np.maximum(worst, np.abs(records['alpha_meas']))
    assert_allclose(coupling[:, 0], worst, rtol=1e-4)
    assert (coupling[:, 1] == 0.0).all()
    assert coupling[1, 0] > 1.0  # a lever of 0.2 m on an edge of 0.08 m


TILT = np.radians(20.0)
TRUE_NORMAL = np.array([np.sin(TILT), 0.0, -np.cos(TILT)])
DOWNHILL = np.array([np.cos(TILT), 0.0, np.sin(TILT)])


CONFIGURED_NORMAL = np.array([0.0, 0.0, -1.0])


STIFFNESS = 10000.0  # N/m


def follow(velocity, ticks, into_surface=0.0):
    """
    Return the normal after samples of 10 N on a tilted surface that rubs with 1 N.

    The tip slides with `velocity`, and goes into the surface at `into_surface` (m/s).
    """
    frame = np.zeros(1, dtype=FRAME)[0]
    contacts = np.zeros(1, dtype=CONTACT)
    frame['rotation'] = np.eye(3)
    frame['twist'][:3] = velocity + into_surface * TRUE_NORMAL
    config = contacts['config']
    contacts['normal'] = CONFIGURED_NORMAL
    contacts['stiffness'] = STIFFNESS
    contacts['answer']['active'] = True
    contacts['answer']['alpha_rate_est'] = STIFFNESS * into_surface
    config['normal'] = CONFIGURED_NORMAL
    config['normal_gain'] = 0.1
    config['turn_limit'] = 0.1
    config['smallest_cosine'] = np.cos(0.6)
    force = 10.0 * TRUE_NORMAL + velocity / np.linalg.norm(velocity)
    for _ in range(ticks):
        normal = contacts['normal'][0]
        contacts['alpha_meas'] = force @ normal
        contacts['friction'] = force - (force @ normal) * normal
        follow_surfaces(frame, contacts)
    return contacts['normal'][0]


@pytest.mark.parametrize(
    'velocity',
    [
        0.05 * DOWNHILL,
        -0.05 * DOWNHILL,
        np.array([0.0, 0.05, 0.0]),
        0.04 * DOWNHILL + [0.0, 0.04, 0.0],
    ],
)
def test_normal_follows_the_surface_that_is_slid_along(velocity):
    assert_allclose(follow(velocity, ticks=300), TRUE_NORMAL, atol=1e-9)


@pytest.mark.parametrize('into_surface', [0.01, -0.01])
def test_normal_is_not_led_by_what_goes_into_the_surface(into_surface):
    normal = follow(0.05 * DOWNHILL, ticks=300, into_surface=into_surface)
    assert_allclose(normal, TRUE_NORMAL, atol=1e-6)


@pytest.mark.parametrize(
    'velocity',
    [
        0.02 * DOWNHILL,  # too slow to have a direction
        0.2 * TRUE_NORMAL,
        -0.2 * TRUE_NORMAL,
        np.array([0.0, 0.0, 0.1]),
        np.array([0.05, 0.0, 0.1]),
    ],
)
def test_normal_stays_where_the_tip_hardly_slides_or_bounces(velocity):
    assert_allclose(follow(velocity, ticks=1), CONFIGURED_NORMAL, atol=1e-9)
