"""Motions that a page asks for: smooth, inside the workspace, and where they were asked to go."""

from multicontact_control.config import LimitsConfig
from multicontact_control.errors import CommandError
from multicontact_control.view.motion import (
    CommandedMotion,
    USUAL_ACCELERATION,
    USUAL_SPEED,
)
import numpy as np
import pytest

PERIOD = 0.002
START = np.array([0.0, 0.55, 0.65])
LIMITS = LimitsConfig(workspace_lower=(-0.6, 0.2, 0.3), workspace_upper=(0.6, 0.9, 1.2))


def start_motion(limits):
    """Return a motion of an arm that stands at START."""
    motion = CommandedMotion(limits)
    motion.start(START, np.array([0.0, 0.0, 0.0, 1.0]))
    return motion


@pytest.fixture
def motion():
    return start_motion(LIMITS)


def advance_motion(motion, ticks, period=PERIOD):
    """Return position, velocity and acceleration tick by tick, until it comes to rest."""
    positions, velocities, accelerations = [], [], []
    for _ in range(ticks):
        reading = motion.advance(period)
        if reading is not None:
            positions.append(reading.position_world)
            velocities.append(reading.twist_world[:3])
            accelerations.append(reading.acceleration_world[:3])
    return np.array(positions), np.array(velocities), np.array(accelerations)


def assert_smooth(position, velocity, acceleration):
    middle = 0.5 * (velocity[1:] + velocity[:-1])
    speed = np.diff(position, axis=0) / PERIOD
    np.testing.assert_allclose(speed, middle, atol=2e-3)
    change = np.diff(velocity, axis=0) / PERIOD
    tolerance = 0.02 + 0.1 * USUAL_ACCELERATION
    np.testing.assert_allclose(change, acceleration[1:], atol=tolerance)


@pytest.mark.parametrize('period', [PERIOD, 0.1])
def test_motion_goes_to_a_point_within_its_speed_and_rests_there(motion, period):
    assert motion.advance(period) is None
    assert motion.name == ''
    motion.go_to(START + [0.1, 0.05, 0.0])
    position, velocity, acceleration = advance_motion(motion, 4000, period)
    np.testing.assert_allclose(position[-1], START + [0.1, 0.05, 0.0], atol=1e-9)
    np.testing.assert_array_equal(velocity[-1], 0.0)
    assert np.linalg.norm(velocity, axis=1).max() <= USUAL_SPEED * 1.0001
    assert np.linalg.norm(acceleration, axis=1).max() <= USUAL_ACCELERATION * 1.0001
    assert (np.diff(position[:, 0]) > -1e-9).all(), 'it went beyond and came back'
    assert motion.advance(PERIOD) is None
    assert motion.goal is None


def test_dragged_handle_makes_no_jump(motion):
    parts = []
    for goal in ([0.05, 0, 0], [0.05, -0.1, 0], [-0.1, 0, 0.2]):
        motion.go_to(START + goal)
        parts.append(advance_motion(motion, 150))
    assert_smooth(*np.concatenate(parts, axis=1))


def test_sine_begins_and_ends_without_a_jump(motion):
    motion.start_sine('x', 0.08, 4.0)
    moving = advance_motion(motion, 3000)
    motion.stop()
    stopping = advance_motion(motion, 3000)
    assert_smooth(*np.concatenate([moving, stopping], axis=1))
    time = PERIOD * np.arange(1001, 3001)
    sine = 0.08 * np.sin(0.5 * np.pi * time)
    position, *_ = moving
    np.testing.assert_allclose(position[1000:, 0] - START[0], sine, atol=1e-9)
    _, velocity, _ = stopping
    np.testing.assert_array_equal(velocity[-1], 0.0)
    assert motion.name == ''


@pytest.mark.parametrize(('amplitude', 'period'), [(0.08, 4.0), (0.08, 2.0)])
@pytest.mark.parametrize('ticks', [1500, 1700, 1900, 2100, 2400])
def test_stop_brings_a_sine_to_rest_where_the_point_is(
    motion, amplitude, period, ticks
):
    motion.start_sine('x', amplitude, period)
    positions, velocities, _ = advance_motion(motion, ticks)
    before = positions[-1]
    speed = np.linalg.norm(velocities[-1])
    motion.stop()
    position, _, acceleration = advance_motion(motion, 2000)
    assert motion.name == ''
    # A sine that comes has up to a tenth more than one that stays.
    sine_acceleration = 1.1 * amplitude * (2.0 * np.pi / period) ** 2
    largest = max(USUAL_ACCELERATION, sine_acceleration)
    assert np.linalg.norm(acceleration, axis=1).max(initial=0.0) <= largest
    way = speed**2 / (2.0 * USUAL_ACCELERATION)  # of a speed that shrinks evenly
    assert np.abs(position - before).max(initial=0.0) <= way + 0.001
    assert np.abs(position[:, 0] - START[0]).max(initial=0.0) <= amplitude + 0.001


def test_motion_out_of_the_workspace_is_refused_and_changes_nothing(motion):
    message = 'position y: expected 0.2 to 0.9 m, got 0.95 m'
    with pytest.raises(CommandError, match=message):
        motion.go_to(START + [0.0, 0.4, 0.0])
    motion.jog([0.0, 0.3, 0.0])
    with pytest.raises(CommandError, match='position y'):
        motion.start_sine('y', 0.1, 4.0)
    motion.start_sine('x', 0.1, 4.0)
    with pytest.raises(CommandError, match='position x'):
        motion.jog([0.55, 0.0, 0.0])
    assert motion.name == 'sine along x'
    np.testing.assert_allclose(motion.goal, START + [0.0, 0.3, 0.0])


def test_sine_faster_than_the_limits_is_refused(motion):
    with pytest.raises(CommandError, match='speed: expected at most 0.5 m/s'):
        motion.start_sine('x', 0.15, 2.0)
    assert motion.name == ''


def test_slow_arm_is_led_slowly():
    slow = {'operational_speed': 0.04, 'operational_acceleration': 0.2}
    motion = start_motion(LIMITS.model_copy(update=slow))
    motion.go_to(START + [0.1, 0.0, 0.0])
    position, velocity, acceleration = advance_motion(motion, 4000)
    np.testing.assert_allclose(position[-1], START + [0.1, 0.0, 0.0], atol=1e-9)
    assert 0.018 < np.linalg.norm(velocity, axis=1).max() <= 0.02 * 1.0001
    assert np.linalg.norm(acceleration, axis=1).max() <= 0.1 * 1.0001
