"""Motions that a page asks for: smooth, inside the workspace, and where they were asked to go."""

from __future__ import annotations

from multicontact_control.config import LimitsConfig
from multicontact_control.errors import CommandError
from multicontact_control.view.motion import ACCELERATION, Motion, Pattern, SPEED
import numpy as np
import pytest

PERIOD = 0.002
START = np.array([0.0, 0.55, 0.65])
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
LIMITS = LimitsConfig(workspace_lower=(-0.6, 0.2, 0.3), workspace_upper=(0.6, 0.9, 1.2))


@pytest.fixture
def motion():
    made = Motion(LIMITS, PERIOD)
    made.start(START, UPRIGHT)
    return made


def path(motion, ticks):
    """Return position, velocity and acceleration tick by tick, until it comes to rest."""
    readings = [reading for _ in range(ticks) if (reading := motion.advance()) is not None]
    return [np.array([getattr(reading, name)[:3] for reading in readings]) for name in (
        'position_world', 'twist_world', 'acceleration_world')]


def assert_smooth(position, velocity, acceleration):
    """Check that the position does what is said of speed and acceleration."""
    middle = 0.5 * (velocity[1:] + velocity[:-1])
    np.testing.assert_allclose(np.diff(position, axis=0) / PERIOD, middle, atol=2e-3)
    np.testing.assert_allclose(
        np.diff(velocity, axis=0) / PERIOD, acceleration[1:], atol=0.02 + 0.1 * ACCELERATION)


def test_nothing_is_commanded_before_anything_is_asked_for(motion):
    assert motion.advance() is None
    assert motion.what == ''


def test_it_goes_to_a_point_within_its_speed_and_rests_there(motion):
    motion.go_to(START + [0.1, 0.05, 0.0])
    position, velocity, acceleration = path(motion, 4000)
    np.testing.assert_allclose(position[-1], START + [0.1, 0.05, 0.0], atol=1e-9)
    np.testing.assert_array_equal(velocity[-1], 0.0)
    assert np.linalg.norm(velocity, axis=1).max() <= SPEED * 1.0001
    assert np.linalg.norm(acceleration, axis=1).max() <= ACCELERATION * 1.0001
    assert (np.diff(position[:, 0]) > -1e-9).all(), 'it went beyond and came back'
    assert motion.advance() is None and motion.goal is None


def test_a_handle_that_is_dragged_makes_no_jump(motion):
    parts = []
    for goal in (START + [0.05, 0, 0], START + [0.05, -0.1, 0], START + [-0.1, 0, 0.2]):
        motion.go_to(goal)
        parts.append(path(motion, 150))
    assert_smooth(*(np.concatenate(each) for each in zip(*parts)))


@pytest.mark.parametrize(('kind', 'axes'), [('sine', 'x'), ('circle', 'xy')])
def test_patterns_come_and_go_without_a_jump(motion, kind, axes):
    motion.start_pattern(Pattern(kind, axes, 0.08, 4.0))
    parts = [path(motion, 3000)]
    motion.stop()
    parts.append(path(motion, 3000))
    position, velocity, acceleration = (np.concatenate(each) for each in zip(*parts))
    assert_smooth(position, velocity, acceleration)
    away = position - START
    assert 0.079 < np.abs(away).max() <= 0.08 + 1e-9
    settled = away[1000:3000]
    if kind == 'circle':
        np.testing.assert_allclose(np.linalg.norm(settled, axis=1), 0.08, atol=1e-9)
    np.testing.assert_allclose(position[-1], START, atol=1e-9)
    assert motion.what == ''


def test_what_would_leave_the_workspace_is_refused_and_changes_nothing(motion):
    with pytest.raises(CommandError, match='position y: expected 0.2 to 0.9 m, found 0.95 m'):
        motion.go_to(START + [0.0, 0.4, 0.0])
    motion.jog([0.0, 0.3, 0.0])
    with pytest.raises(CommandError, match='position y'):
        motion.start_pattern(Pattern('sine', 'y', 0.1, 4.0))
    motion.start_pattern(Pattern('sine', 'x', 0.1, 4.0))
    with pytest.raises(CommandError, match='position x'):
        motion.jog([0.55, 0.0, 0.0])
    assert motion.what == 'sine along x'
    np.testing.assert_allclose(motion.goal, START + [0.0, 0.3, 0.0])


@pytest.mark.parametrize('wrong', [
    ('square', 'x', 0.1, 4.0), ('sine', 'xy', 0.1, 4.0), ('circle', 'xx', 0.1, 4.0),
    ('sine', 'w', 0.1, 4.0), ('sine', 'x', 0.4, 4.0), ('sine', 'x', float('nan'), 4.0),
    ('sine', 'x', 0.1, 0.5)])
def test_patterns_that_make_no_sense_are_refused(wrong):
    with pytest.raises(CommandError):
        Pattern(*wrong)


def test_what_contacts_do_not_let_happen_is_given_up(motion):
    """A contact holds z: the rest of the way goes on, and nothing waits for it to let go."""
    motion.go_to(START + [0.05, 0.0, 0.05])
    while (reading := motion.advance()) is not None:
        motion.accepted(np.array([*reading.position_world[:2], START[2]]))
    motion.jog([0.01, 0.0, 0.0])
    position, velocity, _ = path(motion, 2000)
    np.testing.assert_allclose(position[-1], START + [0.06, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(velocity[:, 2], 0.0, atol=1e-9)
