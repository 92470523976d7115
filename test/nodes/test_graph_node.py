"""What the nodes share: what is refused is logged once per cause."""

from multicontact_control.config import ToolConfig
from multicontact_control.errors import (
    CalibrationError,
    MessageError,
    RunError,
    ShapeError,
    SingularTaskError,
)
from multicontact_control.nodes.graph_node import Refusals
from multicontact_control.sensor.tare import tare_bias
import numpy as np
import pytest
from rclpy.logging import get_logger


def restless(seed):
    """Return what a tare says of readings that are not at rest."""
    readings = 9.0 * np.random.default_rng(seed).standard_normal((200, 6))
    with pytest.raises(CalibrationError) as caught:
        tare_bias(readings, np.eye(3), ToolConfig(), np.array([0.0, 0.0, -9.81]))
    return caught.value


@pytest.mark.parametrize('make', [
    restless, lambda k: ShapeError('q', (6,), (k,)),
    lambda k: RunError(f'stamp: expected a number, found {k}'),
    lambda k: SingularTaskError(f'J: expected a condition number below 1e8, found {k}'),
    lambda k: MessageError('effort', 'finite numbers', [float(k)])])
def test_a_cause_is_counted_as_one_whatever_was_found(make):
    errors = [make(k) for k in (1, 2, 3)]
    assert len({str(error) for error in errors}) == 3
    refusals = Refusals(get_logger('test'))
    for error in errors:
        refusals.refuse('~/tare', error)
    refusals.refuse('~/hold', errors[0])
    assert sorted(refusals.counts.values()) == [1, 3]
    assert all(', found' not in cause for cause in refusals.counts)
