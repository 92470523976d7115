"""Wrong joint speeds, and wrist sensors that were never tared or have other units."""

from campaign.velocities import Cell, LARGEST, run
import pytest


@pytest.mark.parametrize('cell', [
    Cell('panda', False, True, 'joints:in_degrees_qd'),
    Cell('puma', True, False, 'joints:sign_flipped_qd_of_one', 1)])
def test_wrong_speeds_are_named_and_move_nothing(cell):
    """From the first sample on; unchecked: 24 rad/s and 1100 N."""
    (expected, *_), (speeds, force, _, causes) = run(Cell(*cell[:3])), run(cell)
    assert (speeds - expected).max() < LARGEST['rad/s beyond']
    assert force < LARGEST['N']
    assert 'joints_velocity' in causes


@pytest.mark.parametrize('cell', [
    Cell('panda', False, True, 'wrench:biased_by_50%', 2),
    Cell('puma', False, False, 'wrench:biased_by_50%', 2)])
def test_unproven_sensor_moves_nothing(cell):
    """Within 10 s; unchecked: 0.3 m."""
    _, _, way, causes = run(cell)
    assert way < LARGEST['mm']
    assert causes
