"""Commands beyond the limits are refused by name."""

from arms import controller_config
from multicontact_control.config import LimitsConfig
from multicontact_control.contact.geometry import offset_shares
from multicontact_control.control.tasks import MotionReading
from multicontact_control.errors import CommandError
from multicontact_control.supervision.command_limits import (
    check_motion,
    check_position,
    CommandLimits,
)
import numpy as np
import pytest

EDGE = controller_config(contacts={'table': {
    'type': 'edge', 'direction_operational': [1.0, 0.0, 0.0], 'half_length': 0.02}})


def test_check_forces_takes_what_is_within():
    limits = CommandLimits(force_ceiling=10.0)
    assert limits.check_forces(EDGE, {'table': 0.0, 'board': 10.0}) is None
    assert limits.check_forces(EDGE, {'table': 3.0, 'table/along': -1.0}) is None
    assert limits.check_forces(
        EDGE, {'table': 3.0, 'table/along': 9.0}, shares={'table/along': 0.1}) is None


@pytest.mark.parametrize(('forces', 'before', 'shares'), [
    ({'table': 5.0, 'table/along': -5.0}, {}, {}), ({'table/along': 5.0}, {'table': 5.0}, {}),
    ({'table': 5.0}, {}, {'table/along': -1.0})])
def test_check_forces_refuses_a_centre_of_pressure_outside_the_contact(forces, before, shares):
    with pytest.raises(CommandError, match='centre of pressure of table/along: expected at most'):
        CommandLimits().check_forces(EDGE, forces, before, shares)


@pytest.mark.parametrize('force', [10.1, 2.9, -0.1, float('nan'), float('inf')])
def test_check_forces_names_the_contact(force):
    with pytest.raises(CommandError, match='force on board: expected 0 or 3 to 10 N'):
        CommandLimits(force_ceiling=10.0).check_forces(EDGE, {'table': 3.0, 'board': force})


@pytest.mark.parametrize(('forces', 'found'), [
    ({'wall': 5.0}, "contact: expected one of table, table/along, board, found 'wall'"),
    ({'table/along': -31.0}, 'force on table/along: expected 0 or -30 to 30 N'),
    ({'table/along': float('nan')}, 'force on table/along')])
def test_check_forces_refuses_unknown_contacts_and_couples_beyond_the_ceiling(forces, found):
    with pytest.raises(CommandError, match=found):
        CommandLimits().check_forces(EDGE, forces)


@pytest.mark.parametrize(('centres', 'found'), [
    ({'table': 0.01}, 'a finite one of table/along'), ({'table/along': float('nan')}, 'nan m')])
def test_offset_shares_refuses_what_is_no_centre_of_pressure(centres, found):
    assert offset_shares(EDGE, {'table/along': 0.01}) == {'table/along': 0.5}
    with pytest.raises(CommandError, match=found):
        offset_shares(EDGE, centres)


@pytest.mark.parametrize('part', range(4))
def test_check_motion_refuses_numbers_that_are_not_finite(part):
    motion = [np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(6), np.zeros(6)]
    check_motion(MotionReading(*motion), LimitsConfig())
    motion[part] = motion[part] + np.inf
    with pytest.raises(CommandError, match='motion: expected finite numbers'):
        check_motion(MotionReading(*motion), LimitsConfig())


def test_check_motion_refuses_a_quaternion_without_length():
    with pytest.raises(CommandError, match='a quaternion that is not 0'):
        check_motion(MotionReading(*(np.zeros(n) for n in (3, 4, 6, 6))), LimitsConfig())


def test_check_position_names_the_axis():
    limits = LimitsConfig(workspace_lower=(-1.0,) * 3, workspace_upper=(1.0, 1.0, 1.5))
    check_position(np.array([0.5, -0.5, 1.0]), limits)
    check_position(np.array([50.0, 0.0, 1.0]), LimitsConfig())  # no box
    for bad in (-1.1, float('nan')):
        with pytest.raises(CommandError, match='position y: expected -1 to 1 m'):
            check_position(np.array([0.5, bad, 1.0]), limits)
