"""Commands beyond the limits are refused by name."""

from multicontact_control.config import LimitsConfig
from multicontact_control.errors import CommandError
from multicontact_control.supervision.command_limits import check_position, CommandLimits
import numpy as np
import pytest


def test_check_forces_takes_what_is_within():
    limits = CommandLimits(force_ceiling=10.0)
    assert limits.check_forces({'a': 0.0, 'b': 10.0, 'c': 2.0}, 2.0) is None
    assert limits.check_forces({'a/along': -10.0}, 2.0, ['a/along']) is None


@pytest.mark.parametrize('force', [10.1, 1.9, -0.1, float('nan'), float('inf')])
def test_check_forces_names_the_contact(force):
    with pytest.raises(CommandError, match='force on b: expected 0 or 2 to 10 N'):
        CommandLimits(force_ceiling=10.0).check_forces({'a': 3.0, 'b': force}, 2.0)


def test_check_position_names_the_axis():
    limits = LimitsConfig(workspace_lower=(-1.0,) * 3, workspace_upper=(1.0, 1.0, 1.5))
    check_position(np.array([0.5, -0.5, 1.0]), limits)
    check_position(np.array([50.0, 0.0, 1.0]), LimitsConfig())  # no box
    for bad in (-1.1, float('nan')):
        with pytest.raises(CommandError, match='position y: expected -1 to 1 m'):
            check_position(np.array([0.5, bad, 1.0]), limits)
