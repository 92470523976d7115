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
        (swing(13)[1], 'delay'),
    ],
)
def test_what_is_wrong_with_a_velocity_is_named(velocity, likely):
    states = np.hstack([Q, velocity])
    text = explain_velocities(states, np.array([1.5, 2.0]), NAMES, PERIOD)
    assert text.startswith('joint2: its velocity is')
    assert likely in text


@pytest.mark.parametrize(('q', 'qd'), [(Q, QD), (Q[:5], -QD[:5])])
def test_nothing_is_said_of_right_velocities_nor_of_few(q, qd):
    states = np.hstack([q, qd])
    assert explain_velocities(states, np.array([0.5, 0.2]), NAMES, PERIOD) == ''
