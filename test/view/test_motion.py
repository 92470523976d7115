"""Motions that a page asks for: smooth, inside the workspace, and where they were asked to go."""

from multicontact_control.config import LimitsConfig
from multicontact_control.errors import CommandError
from multicontact_control.view.motion import ACCELERATION, CommandedMotion, SPEED
import numpy as np
import pytest

PERIOD = 0.002
START = np.array([0.0, 0.55, 0.65])
LIMITS = LimitsConfig(workspace_lower=(-0.6, 0.2, 0.3), workspace_upper=(0.6, 0.9, 1.2))


@pytest.fixture
def motion():
    made = CommandedMotion(LIMITS)
    made.start(START, np.array([0.0, 0.0, 0.0, 1.0]))
    return made


def path(motion, ticks, period=PERIOD):
    """Return position, velocity and acceleration tick by tick, until it comes to rest."""
    readings = filter(None, (motion.advance(period) for _ in range(ticks)))
    return [
        np.array(x)
        for x in zip(
            *(
                (x.position_world, x.twist_world[:3], x.acceleration_world[:3])
                for x in readings
            )
        )
    ]


def assert_smooth(position, velocity, acceleration):
    middle = 0.5 * (velocity[1:] + velocity[:-1])
    np.testing.assert_allclose(np.diff(position, axis=0) / PERIOD, middle, atol=2e-3)
    np.testing.assert_allclose(
        np.diff(velocity, axis=0) / PERIOD,
        acceleration[1:],
        atol=0.02 + 0.1 * ACCELERATION,
    )


@pytest.mark.parametrize('period', [PERIOD, 0.1])
def test_motion_goes_to_a_point_within_its_speed_and_rests_there(motion, period):
    assert motion.advance(period) is None and motion.what == ''
    motion.go_to(START + [0.1, 0.05, 0.0])
    position, velocity, acceleration = path(motion, 4000, period)
    np.testing.assert_allclose(position[-1], START + [0.1, 0.05, 0.0], atol=1e-9)
    np.testing.assert_array_equal(velocity[-1], 0.0)
    assert np.linalg.norm(velocity, axis=1).max() <= SPEED * 1.0001
    assert np.linalg.norm(acceleration, axis=1).max() <= ACCELERATION * 1.0001
    assert (np.diff(position[:, 0]) > -1e-9).all(), 'it went beyond and came back'
    assert motion.advance(PERIOD) is None and motion.goal is None


def test_dragged_handle_and_sine_make_no_jump(motion):
    parts = [
        path(motion, 150)
        for goal in ([0.05, 0, 0], [0.05, -0.1, 0], [-0.1, 0, 0.2])
        if motion.go_to(START + goal)
    ]
    assert_smooth(*(np.concatenate(each) for each in zip(*parts)))
    motion.start(START, np.array([0.0, 0.0, 0.0, 1.0]))
    motion.start_sine('x', 0.08, 4.0)
    parts = [path(motion, 3000)]
    motion.stop()
    parts.append(path(motion, 3000))
    position, velocity, acceleration = (np.concatenate(each) for each in zip(*parts))
    assert_smooth(position, velocity, acceleration)
    time = PERIOD * np.arange(1000, 3000) + PERIOD
    np.testing.assert_allclose(
        position[1000:3000, 0] - START[0], 0.08 * np.sin(0.5 * np.pi * time), atol=1e-9
    )
    np.testing.assert_array_equal(velocity[-1], 0.0)
    assert motion.what == ''


@pytest.mark.parametrize(('amplitude', 'period'), [(0.08, 4.0), (0.08, 2.0)])
@pytest.mark.parametrize('ticks', [1500, 1700, 1900, 2100, 2400])
def test_stop_brings_a_sine_to_rest_where_the_point_is(
    motion, amplitude, period, ticks
):
    motion.start_sine('x', amplitude, period)
    before, speed, _ = (values[-1] for values in path(motion, ticks))
    motion.stop()
    position, velocity, acceleration = path(motion, 2000)
    assert motion.what == ''
    # A sine that comes has up to a tenth more than one that stays.
    largest = max(ACCELERATION, 1.1 * amplitude * (2.0 * np.pi / period) ** 2)
    assert np.linalg.norm(acceleration, axis=1).max(initial=0.0) <= largest
    way = speed @ speed / (2.0 * ACCELERATION)  # of a speed that shrinks evenly
    assert np.abs(position - before).max(initial=0.0) <= way + 0.001
    assert np.abs(position[:, 0] - START[0]).max(initial=0.0) <= amplitude + 0.001


def test_motion_out_of_the_workspace_is_refused_and_changes_nothing(motion):
    with pytest.raises(
        CommandError, match='position y: expected 0.2 to 0.9 m, got 0.95 m'
    ):
        motion.go_to(START + [0.0, 0.4, 0.0])
    motion.jog([0.0, 0.3, 0.0])
    with pytest.raises(CommandError, match='position y'):
        motion.start_sine('y', 0.1, 4.0)
    motion.start_sine('x', 0.1, 4.0)
    with pytest.raises(CommandError, match='position x'):
        motion.jog([0.55, 0.0, 0.0])
    assert motion.what == 'sine along x'
    np.testing.assert_allclose(motion.goal, START + [0.0, 0.3, 0.0])


def test_sine_faster_than_the_limits_is_refused_and_a_slow_arm_is_led_slowly(motion):
    with pytest.raises(CommandError, match='speed: expected at most 0.5 m/s'):
        motion.start_sine('x', 0.15, 2.0)
    assert motion.what == ''
    slow = CommandedMotion(
        LIMITS.model_copy(
            update={'operational_speed': 0.04, 'operational_acceleration': 0.2}
        )
    )
    slow.start(START, np.array([0.0, 0.0, 0.0, 1.0]))
    slow.go_to(START + [0.1, 0.0, 0.0])
    position, velocity, acceleration = path(slow, 4000)
    np.testing.assert_allclose(position[-1], START + [0.1, 0.0, 0.0], atol=1e-9)
    assert 0.018 < np.linalg.norm(velocity, axis=1).max() <= 0.02 * 1.0001
    assert np.linalg.norm(acceleration, axis=1).max() <= 0.1 * 1.0001
