"""Joint speeds that are wrong beside right positions: the arm does not run away, and says why."""

from campaign.velocities import Cell, LARGEST, run
import pytest


@pytest.mark.parametrize('cell', [
    Cell('panda', False, True, 'joints:in_degrees_qd'),
    Cell('puma', True, False, 'joints:sign_flipped_qd_of_one', 1)])
def test_wrong_speeds_are_named_and_move_nothing(cell):
    """From the first sample on; before, 24 rad/s and 1100 N."""
    (expected, *_), (speeds, force, _, causes) = run(Cell(*cell[:3])), run(cell)
    assert (speeds - expected).max() < LARGEST['rad/s beyond']
    assert force < LARGEST['N']
    assert 'joints_velocity' in causes
