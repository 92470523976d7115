"""What positions say against velocities that are wrong."""

from multicontact_control.diagnosis.velocities import explain_velocities
import numpy as np
import pytest

PERIOD = 0.002
NAMES = ('joint1', 'joint2')
RATE = 60.0  # rad/s


def swing(delay=0):
    """Return positions and velocities of joints that swing once in 52 samples, shape (50, 2)."""
    phase = RATE * PERIOD * (np.arange(50.0) - delay)
    both = np.column_stack([phase, phase])
    position = 0.3 - 0.2 / RATE * np.cos(both)
    return position, 0.2 * np.sin(both)


Q, QD = swing()


@pytest.mark.parametrize(
    ('velocity', 'likely'),
    [
        (np.degrees(QD), 'degrees per second'),
        (QD / (2.0 * np.pi), 'revolutions per second'),
        (0.02 * QD, '0.02 times'),
        (-QD, 'opposite sign'),
        (Q, 'equal to its position'),
        (QD + 0.3, 'offset'),
        (0.0 * QD + 0.3, 'frozen'),
        (0.0 * QD + np.inf, 'finite'),
        (swing(13)[1], 'delayed'),
    ],
)
def test_what_is_wrong_with_a_velocity_is_named(velocity, likely):
    states = np.hstack([Q, velocity])
    text = explain_velocities(states, np.array([1.5, 2.0]), NAMES, PERIOD)
    assert text.startswith('joint2: its velocity is')
    assert likely in text


def explain_one(position, velocity, doubt):
    """Return what is said of one joint."""
    states = np.column_stack([position, velocity])
    return explain_velocities(states, np.array([doubt]), NAMES[:1], PERIOD)


def test_velocity_that_is_right_may_stay_the_same():
    position = 0.2 * PERIOD * np.arange(50)
    assert explain_one(position, np.full(50, 0.2), 0.1) == ''


def test_velocity_that_stays_the_same_is_frozen_only_if_its_position_moves_otherwise():
    steady = 0.2 * PERIOD * np.arange(50)
    constant = np.full(50, 0.3)
    assert 'is 0.1 rad/s beyond the rate' in explain_one(steady, constant, 2.0)
    assert 'frozen' in explain_one(Q[:, 0], constant, 2.0)


def test_velocity_of_a_joint_at_rest_is_no_multiple_of_its_rate():
    text = explain_one(np.full(50, 0.3), QD[:, 0], 2.0)
    assert 'times' not in text and 'up to 0.2 rad/s off the rate' in text


@pytest.mark.parametrize('count', [50, 5])
def test_nothing_is_said_of_right_velocities_nor_of_few(count):
    velocity = QD if count == 50 else -QD
    states = np.hstack([Q, velocity])[:count]
    assert explain_velocities(states, np.array([0.5, 0.2]), NAMES, PERIOD) == ''
