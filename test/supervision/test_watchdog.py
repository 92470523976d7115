"""What the watchdog refuses and why, how long it bridges, and what it hands over meanwhile."""

from arms import controller_config, HOME
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
from multicontact_control.supervision.validation import Watchdog
import numpy as np
import pytest

CONFIG = controller_config()
H = CONFIG.period
CONTACTS = len(CONFIG.contact_names)
SOURCES = ('joints', 'wrench', 'variance')


def good(k, random):
    """Return the inputs of an arm that moves slowly, with the sensors' noise."""
    q = HOME + 1e-3 * np.sin(k * H) + 1e-9 * random.normal(size=6)
    return TickInputs(
        k * H, JointInput(k * H, q, 1e-3 * np.cos(k * H) + 1e-6 * random.normal(size=6)),
        WrenchInput(k * H, random.normal(size=6)),
        VarianceInput((k - 1) * H, 0.2 + random.random(CONTACTS)))


def changed(inputs, source, **values):
    return inputs._replace(**{source: getattr(inputs, source)._replace(**values)})


def put(number):
    """Return a change that puts a number in the first place of a reading."""
    def change(inputs, source):
        values = getattr(inputs, source)[1].copy()
        values[0] = number
        return changed(inputs, source, **{
            {'joints': 'q', 'wrench': 'wrench', 'variance': 'variance'}[source]: values})
    return change


def warm(ticks=20):
    watchdog, random = Watchdog(CONFIG), np.random.default_rng(0)
    for k in range(ticks):
        valid = watchdog.validate(good(k, random))
        assert (valid.causes, valid.rejected) == ((), ())
    return watchdog, random


FAULTS = [
    ('joints', put(np.nan), 'joints_invalid'), ('joints', put(2e3), 'joints_implausible'),
    ('joints', put(HOME[0] + 0.02), 'joints_jump'), ('joints', put(HOME[0] - 0.02), 'joints_jump'),
    ('wrench', put(np.inf), 'wrench_invalid'),
    ('wrench', put(2e6), 'wrench_invalid'), ('wrench', put(100.0), 'wrench_saturated'),
    ('variance', put(np.nan), 'variance_invalid'), ('variance', put(-1.0), 'variance_invalid'),
    ('joints', lambda x, s: changed(x, s, q=[0.0] * 5), 'joints_invalid'),
    ('joints', lambda x, s: changed(x, s, qd='fast'), 'joints_invalid'),
    *((source, lambda x, s: changed(x, s, stamp=x.time + H), f'{source}_stamp')
      for source in SOURCES),
    *((source, lambda x, s: changed(x, s, stamp=None), f'{source}_stamp') for source in SOURCES),
    *((source, lambda x, s: changed(x, s, stamp=x.time - 5 * H), f'{source}_order')
      for source in SOURCES)]


@pytest.mark.parametrize(('source', 'change', 'name'), FAULTS)
def test_fault_of_a_reading_is_named_and_its_numbers_are_not_used(source, change, name):
    watchdog, random = warm()
    before = watchdog.validate(good(20, random))
    kept = [getattr(before, field).copy() for field in ('q', 'wrench', 'variance')]
    inputs = good(21, random)
    valid = watchdog.validate(change(inputs, source))
    assert valid.rejected == (name,)
    places = {'joints': (valid.q, kept[0]), 'wrench': (valid.wrench, kept[1]),
              'variance': (valid.variance, kept[2])}
    np.testing.assert_array_equal(*places[source])
    assert valid.measured == (source != 'wrench')
    if source != 'joints':
        np.testing.assert_array_equal(valid.q, inputs.joints.q)


@pytest.mark.parametrize(('source', 'bridged'), [('joints', 1), ('wrench', 12), ('variance', 3)])
def test_missing_reading_is_bridged_for_its_largest_age_and_then_a_cause(source, bridged):
    """R is a period old when all is well."""
    watchdog, random = warm()
    causes = [watchdog.validate(good(k, random)._replace(**{source: None})).causes
              for k in range(20, 40)]
    assert causes == [()] * bridged + [(f'{source}_stale',)] * (20 - bridged)
    assert watchdog.validate(good(40, random)).causes == ()


def test_variance_keeps_to_its_limits_and_grows_while_it_is_not_renewed():
    watchdog, random = warm()
    for k, (given_r, used) in enumerate(
            ((1e-3, 0.1), (7.0, 7.0), (1e5, 1e3), (7.0, 7.0)), 20):
        inputs = changed(good(k, random), 'variance', variance=np.full(CONTACTS, given_r))
        np.testing.assert_array_equal(watchdog.validate(inputs).variance, used)
    found = [watchdog.validate(good(k, random)._replace(variance=None)).variance[0]
             for k in range(k + 1, k + 80)]
    np.testing.assert_allclose(found[:3], 7.0)
    np.testing.assert_allclose(found[3:], np.minimum(7.0 * 1.1 ** np.arange(1, 77), 1e3))


def test_frozen_readings_are_noticed_at_their_second_repetition():
    watchdog, random = warm()
    inputs, found = good(20, random), []
    for k in range(20, 25):
        inputs = changed(changed(inputs._replace(time=k * H), 'wrench', stamp=k * H),
                         'joints', stamp=k * H)
        found.append(watchdog.validate(inputs._replace(variance=good(k, random).variance)))
    assert [valid.rejected for valid in found] == [()] * 2 + [
        ('joints_frozen', 'wrench_frozen')] * 3


def test_joints_are_refused_for_the_recovery_time_after_a_jump():
    watchdog, random = warm()
    away = np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.0])
    rejected = []
    for k in range(20, 60):
        inputs = good(k, random)
        rejected.append(watchdog.validate(
            changed(inputs, 'joints', q=inputs.joints.q + away)).rejected)
    refused = 1 + round(CONFIG.watchdog.recovery_time / H)
    assert rejected == [('joints_jump',)] * refused + [()] * (40 - refused)


@pytest.mark.parametrize(('times', 'causes'), [
    ((20, 19), ('clock_backwards',)), ((20, np.nan), ('clock_invalid',)),
    ((20, 23), ()), ((20, 23, 26), ('clock_rate',)), ((20, 20.3, 20.6), ('clock_rate',))])
def test_fault_of_the_clock_is_named(times, causes):
    """An odd period is one only twice in a row; joints and wrenches come in time."""
    watchdog, random = warm()
    for tick in times:
        inputs = good(tick if np.isfinite(tick) else 21, random)
        valid = watchdog.validate(inputs._replace(time=tick * H))
    assert tuple(cause for cause in valid.causes if cause.startswith('clock')) == causes


def test_tick_that_comes_again_is_repeated_once_and_then_a_frozen_clock():
    watchdog, random = warm()
    inputs = good(20, random)
    found = [watchdog.validate(inputs) for _ in range(3)]
    assert [valid.repeated for valid in found] == [False, True, False]
    assert found[2].causes == ('clock_frozen',)
