"""What the nodes share: what is refused is logged once per cause."""

from multicontact_control.errors import MessageError, RunError, ShapeError, SingularTaskError
from multicontact_control.nodes.graph_node import Refusals
import pytest
from rclpy.logging import get_logger


@pytest.mark.parametrize('make', [
    lambda k: ShapeError('q', (6,), (k,)),
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
