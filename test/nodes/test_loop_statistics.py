"""Rates, jitter, ages and refusals from what is known."""

import math
import time

from multicontact_control.errors import MessageError, RunError, ShapeError
from multicontact_control.nodes.diagnostics import Inputs, LoopStatistics
from multicontact_control.nodes.graph import Refusals
from multicontact_control.nodes.topics import JOINT_STATES, WRENCH
import pytest
from rclpy.logging import get_logger

MS = 1_000_000


def test_report_gives_jitter_latency_and_misses_since_the_last():
    watch = LoopStatistics(500.0)
    for k in range(101):
        watch.add_period(1 + k * 2 * MS + (k % 2) * MS // 10)  # 0.1 ms early and late in turn
        watch.latencies.add(300_000 + k * 1000)
    watch.missed = 3
    values = watch.report()
    assert values['jitter_us_p50'] == pytest.approx(100.0)
    assert values['latency_us_p50'] == pytest.approx(350.0)
    assert values['latency_us_max'] == pytest.approx(400.0)
    assert values['deadline_misses'] == 3
    values = watch.report()
    assert (values['deadline_misses'], values['latency_us_p50']) == (0, None)


def test_inputs_know_what_never_came():
    inputs = Inputs(None, 500.0, JOINT_STATES, WRENCH)
    inputs.last[JOINT_STATES] = time.monotonic_ns()
    assert 0.0 <= inputs.age(JOINT_STATES) < inputs.age(WRENCH) == math.inf
    status = inputs.status(needed=True, consequence=': it is held')
    assert status.values['age_s ft_sensor/wrench'] is None
    assert status.warning == 'no ft_sensor/wrench ever: it is held'


@pytest.mark.parametrize('make', [
    lambda k: ShapeError('q', 'shape (6,)', (k,)), lambda k: RunError(f'x: expected 1, found {k}'),
    lambda k: MessageError('effort', 'finite numbers', [float(k)])])
def test_refusals_count_a_cause_as_one_whatever_was_found(make):
    refusals = Refusals(get_logger('test'))
    for source, k in (('~/tare', 1), ('~/tare', 2), ('~/tare', 3), ('~/hold', 1)):
        refusals.refuse(source, make(k))
    assert sorted(refusals.counts.values()) == [1, 3]
