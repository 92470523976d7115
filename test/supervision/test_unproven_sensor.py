"""A sensor that was never tared, or tells other units: it moves no arm that is not commanded."""

from campaign.velocities import Cell, LARGEST, run
import pytest


@pytest.mark.parametrize('cell', [
    Cell('panda', False, True, 'wrench:biased_by_50%', 2),
    Cell('puma', False, False, 'wrench:biased_by_50%', 2)])
def test_unproven_sensor_moves_nothing(cell):
    """Within 10 s; before, by 0.3 m."""
    _, _, way, causes = run(cell)
    assert way < LARGEST['mm']
    assert causes
