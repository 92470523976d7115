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
    records = np.zeros(len(kinds), dtype=CONTACT)
    config = records['config']
    config['kind'], config['direction'], config['half_length'] = kinds, direction, HALF
    records['normal'] = [NORMAL if kind == FORCE else np.zeros(3) for kind in kinds]
    config['point'] = POINT
    config['friction_std'] = [friction if kind == FORCE else 0.0 for kind in kinds]
    config['torsion_std'] = HALF * config['friction_std']
    return records


def point_column(point):
    """Return the wrench of 1 N along the normal at a point, about the origin of world axes."""
    return np.concatenate([NORMAL, np.cross(point, NORMAL)])


def control(wrench, *, separated=False, lever=(0.0, 0.0, 0.06)):
    """Return a record whose sensor, a lever from the operational point, reads a wrench there."""
    record = np.zeros(1, dtype=CONTROL)
    record['frame']['rotation'] = record['frame']['sensor_rotation'] = np.eye(3)
    record['frame']['sensor_position'] = lever
    record['law']['separated'] = separated
    record['law']['force_noise'], record['law']['torque_noise'] = 0.05, 0.004
    moved = wrench.copy()
    moved[3:] -= np.cross(lever, wrench[:3])
    record['wrench'] = moved
    return record[0]


def test_couple_column_is_a_difference_of_forces_at_both_ends():
    """Of 1 N: half a newton more at one end, half a newton less at the other."""
    turn = Rotation.from_rotvec([0.3, -0.2, 0.9]).as_matrix()
    records = columns([FORCE, ALONG, ACROSS], direction=turn.T @ [0.0, 1.0, 0.0])
    records['config']['point'] = POINT @ turn
    N = normal_space(records, turn)
    along = np.array([0.0, 1.0, 0.0])
    across = np.cross(NORMAL, along)
    assert_allclose(N[:, 0], point_column(POINT), atol=1e-15)
    for column, direction in ((1, along), (2, across)):
        ends = [point_column(POINT + side * HALF * direction) for side in (1.0, -1.0)]
        assert_allclose(N[:, column], 0.5 * (ends[0] - ends[1]), atol=1e-15)
    # Forces at both ends are read as their sum and their difference.
    records = columns([FORCE, ALONG])
    wrench = sum(
        force * point_column(POINT + side * HALF * along)
        for side, force in ((-1.0, 4.0), (1.0, 9.0))
    )
    assert measure_contacts(control(wrench), records, SPACE)
    assert_allclose(records['alpha_meas'], [13.0, 5.0], atol=1e-12)


def test_measured_forces_are_generalised_least_squares():
    random = np.random.default_rng(3)
    lever = np.array([0.01, 0.02, 0.06])
    wrench = random.standard_normal(6)
    records = columns([FORCE, ALONG], friction=0.3)
    N = normal_space(records, np.eye(3))
    shift = np.eye(6)  # moves a wrench from the operational point to the sensor
    shift[3:, :3] = -np.array(
        [[0, -lever[2], lever[1]], [lever[2], 0, -lever[0]], [-lever[1], lever[0], 0]]
    )
    across = np.eye(3) - np.outer(NORMAL, NORMAL)
    T = np.vstack([across, np.cross(POINT, across.T).T])
    turn = np.concatenate([np.zeros(3), NORMAL])
    W = (
        np.diag([0.05**2] * 3 + [0.004**2] * 3)
        + shift @ (0.3**2 * (T @ T.T + HALF**2 * np.outer(turn, turn))) @ shift.T
    )
    A = shift @ N
    weight = np.linalg.inv(W)
    expected = np.linalg.solve(A.T @ weight @ A, A.T @ weight @ shift @ wrench)
    assert measure_contacts(
        control(wrench, separated=True, lever=lever), records, SPACE
    )
    assert_allclose(records['alpha_meas'], expected, rtol=1e-9)
    residual = shift @ (wrench - N @ expected)
    assert_allclose(
        records['friction'][0],
        0.3**2 * (shift @ T).T @ weight @ residual,
        rtol=1e-8,
        atol=1e-12,
    )


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
    wrench = 10.0 * point_column(POINT)
    wrench += np.concatenate([friction, np.cross(POINT, friction)])
    reading = control(wrench, separated=True)
    reading['frame']['twist'] = twist
    assert measure_contacts(reading, records, SPACE)
    assert_allclose(records['alpha_meas'], [10.0, 0.0], atol=1e-9)
    assert_allclose(records['friction'][0], friction, atol=1e-9)


def test_contacts_that_cannot_be_told_apart_keep_what_was_measured():
    """All or nothing: no friction of this sample beside forces of another."""
    records = columns([FORCE, FORCE], friction=0.3)
    records['config']['friction_coefficient'] = 0.2
    records['alpha_meas'], records['friction'] = 7.0, 1.5
    sliding = control(np.ones(6), separated=True)
    sliding['frame']['twist'][:3] = 0.0, 0.1, 0.0
    assert not measure_contacts(sliding, records, SPACE)
    assert (records['alpha_meas'] == 7.0).all() and (records['friction'] == 1.5).all()


def test_friction_coupling_is_the_worst_misreading():
    records = columns([FORCE, ALONG])
    coupling = friction_coupling(records.copy(), np.eye(3))
    worst = np.zeros(2)
    across = np.cross(NORMAL, [0.0, 1.0, 0.0])
    for angle in np.linspace(0.0, np.pi, 721):
        friction = np.cos(angle) * np.array([0.0, 1.0, 0.0]) + np.sin(angle) * across
        read = records.copy()
        wrench = np.concatenate([friction, np.cross(POINT, friction)])
        assert measure_contacts(control(wrench), read, SPACE)
        worst = np.maximum(worst, np.abs(read['alpha_meas']))
    assert_allclose(coupling[:, 0], worst, rtol=1e-4)
    assert (coupling[:, 1] == 0.0).all()
    assert coupling[1, 0] > 1.0  # a lever of 0.2 m on an edge of 0.08 m


TILT = np.radians(20.0)
TRUE_NORMAL = np.array([np.sin(TILT), 0.0, -np.cos(TILT)])
DOWNHILL = np.array([np.cos(TILT), 0.0, np.sin(TILT)])


def follow(velocity, ticks=1):
    """Return the normal after samples of 10 N on a tilted surface that rubs with 1 N."""
    frame = np.zeros(1, dtype=FRAME)
    contacts = np.zeros(1, dtype=CONTACT)
    frame['rotation'] = np.eye(3)
    frame['twist'][0, :3] = velocity
    configured = np.array([0.0, 0.0, -1.0])
    config = contacts['config']
    contacts['normal'] = config['normal'] = configured
    contacts['answer']['active'], config['normal_gain'] = True, 0.1
    config['turn_limit'] = 0.1
    config['smallest_cosine'] = np.cos(0.6)
    for _ in range(ticks):
        normal = contacts['normal'][0]
        force = 10.0 * TRUE_NORMAL + velocity / max(np.linalg.norm(velocity), 1e-9)
        contacts['alpha_meas'] = force @ normal
        contacts['friction'] = force - (force @ normal) * normal
        follow_surfaces(frame[0], contacts)
    return contacts['normal'][0]


@pytest.mark.parametrize(
    ('velocity', 'slides'),
    [
        *(
            (velocity, True)
            for velocity in (
                0.05 * DOWNHILL,
                -0.05 * DOWNHILL,
                [0.0, 0.05, 0.0],
                0.04 * DOWNHILL + [0.0, 0.04, 0.0],
            )
        ),
        *(
            (velocity, False)
            for velocity in (  # too slow to have a direction, and bounces
                0.02 * DOWNHILL,
                0.2 * TRUE_NORMAL,
                -0.2 * TRUE_NORMAL,
                [0.0, 0.0, 0.1],
                [0.05, 0.0, 0.1],
            )
        ),
    ],
)
def test_normal_follows_the_surface_that_is_slid_along(velocity, slides):
    normal = follow(np.array(velocity), ticks=300 if slides else 1)
    assert_allclose(normal, TRUE_NORMAL if slides else [0.0, 0.0, -1.0], atol=1e-9)
