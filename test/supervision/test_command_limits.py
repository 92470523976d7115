"""Commands beyond the limits are refused by name."""

from arms import controller_config
from multicontact_control.config import LimitsConfig
from multicontact_control.control.tasks import MotionReading
from multicontact_control.errors import CommandError, ConfigError
from multicontact_control.supervision.command_limits import check_motion, CommandLimits
import numpy as np
import pytest

EDGE = controller_config(
    contacts={
        'table': {
            'type': 'edge',
            'direction_operational': [1.0, 0.0, 0.0],
            'half_length': 0.02,
        }
    }
)
LIMITS = CommandLimits(force_ceiling=10.0)
OUTSIDE = 'centre of pressure of table/along: expected at most'
SHARE = {'table/along': -1.0}


@pytest.mark.parametrize(
    ('forces', 'before', 'shares', 'message'),
    [
        ({'table': 0.0, 'board': 10.0}, {}, {}, ''),
        ({'table': 3.0, 'table/along': -1.0}, {}, {}, ''),
        ({'table': 3.0, 'table/along': 9.0}, {}, {'table/along': 0.1}, ''),
        *(
            (
                {'table': 3.0, 'board': force},
                {},
                {},
                'force on board: expected 0 or 3 to 10 N',
            )
            for force in (10.1, 2.9, -0.1, float('nan'), float('inf'))
        ),
        (
            {'wall': 5.0},
            {},
            {},
            "contact: expected one of table, table/along, board, got 'wall'",
        ),
        (
            {'table/along': -31.0},
            {},
            {},
            'force on table/along: expected 0 or -10 to 10 N',
        ),
        ({'table/along': float('nan')}, {}, {}, 'force on table/along'),
        ({'table': 5.0, 'table/along': -5.0}, {}, {}, OUTSIDE),
        ({'table/along': 5.0}, {'table': 5.0}, {}, OUTSIDE),
        ({'table': 5.0}, {}, SHARE, OUTSIDE),
    ],
)
def test_check_forces_refuses_what_is_unknown_or_beyond_a_limit(
    forces, before, shares, message
):
    if not message:
        LIMITS.check_forces(EDGE, forces, before, shares)
        return
    with pytest.raises(CommandError, match=message):
        LIMITS.check_forces(EDGE, forces, before, shares)


@pytest.mark.parametrize(
    ('twist', 'acceleration', 'message'),
    [
        ([0.3, 0.4, 0, 0, 0, 2.0], [3.0, 4.0, 0, 0, 20.0, 0], ''),
        (
            [0.4, 0.4, 0, 0, 0, 0],
            [0] * 6,
            r'speed: .* most 0.5 m/s \(limits.operational_speed',
        ),
        (
            [0, 0, 0, 0, 0, -2.1],
            [0] * 6,
            r'angular speed: expected at most 2 rad/s .*, got 2.1 rad/s',
        ),
        (
            [0] * 6,
            [0, 0, -6.0, 0, 0, 0],
            r'acceleration: expected at most 5 m/s\^2 .*, got 6 m/s\^2',
        ),
        (
            [0] * 6,
            [0, 0, 0, 30.0, 0, 0],
            r'angular acceleration: expected at most 20 rad/s\^2',
        ),
    ],
)
def test_check_motion_refuses_what_is_faster_than_the_limits(
    twist, acceleration, message
):
    motion = MotionReading(
        np.zeros(3),
        np.array([0.0, 0.0, 0.0, 1.0]),
        np.array(twist, dtype=float),
        np.array(acceleration, dtype=float),
    )
    if not message:
        check_motion(motion, LimitsConfig())
        return
    with pytest.raises(CommandError, match=message):
        check_motion(motion, LimitsConfig())


def test_force_that_a_contact_is_left_for_is_refused_at_the_start():
    with pytest.raises(ConfigError) as caught:
        CommandLimits(force_ceiling=100.0).check(controller_config())
    assert str(caught.value) == (
        'command.force_ceiling: expected below contact_state.force_ceiling 60 N, got 100 N'
    )
    CommandLimits().check(controller_config())
