"""Commands beyond the limits are refused by name."""

from multicontact_control.config import validate
from multicontact_control.control.command_limits import CommandLimits
from multicontact_control.errors import CommandError, ConfigError
import numpy as np
import pytest


def test_check_forces_takes_what_is_within():
    CommandLimits(force_ceiling=10.0).check_forces({'a': 0.0, 'b': 10.0})


@pytest.mark.parametrize('force', [10.1, -0.1, float('nan'), float('inf')])
def test_check_forces_names_the_contact(force):
    with pytest.raises(CommandError, match='force on b: expected 0 to 10 N'):
        CommandLimits(force_ceiling=10.0).check_forces({'a': 1.0, 'b': force})


def test_check_position_names_the_axis():
    limits = CommandLimits()
    limits.check_position(np.array([0.5, -0.5, 1.0]))
    for bad in (-1.1, float('nan')):
        with pytest.raises(CommandError, match='position y: expected -1 to 1 m'):
            limits.check_position(np.array([0.5, bad, 1.0]))


def test_command_error_has_one_cause_for_all_values():
    causes = set()
    for force in (50.0, 60.0):
        with pytest.raises(CommandError) as caught:
            CommandLimits().check_forces({'a': force})
        causes.add(caught.value.cause)
    assert len(causes) == 1


def test_command_limits_refuse_a_box_turned_inside_out():
    with pytest.raises(ConfigError, match='workspace_lower: expected below workspace_upper'):
        validate(CommandLimits, {'workspace_lower': [2.0, 0.0, 0.0]})
