"""What the input stage refuses and why, how long it bridges, its low-pass and its readings."""

from types import SimpleNamespace

from arms import controller_config, HOME
from multicontact_control.config.robot import SensorFrontEndConfig
from multicontact_control.errors import ConfigError
from multicontact_control.force.force_law import make_force_laws
from multicontact_control.records import CONTACT, CONTROL, JOINT
from multicontact_control.supervision.inputs import (
    ALL_VALID,
    Inputs,
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
import numpy as np
import pytest
from scipy.signal import butter, group_delay, lfilter

CONFIG = controller_config()
H = CONFIG.period
CONTACTS = len(CONFIG.contact_names)
RATE = CONFIG.rate


def make(config=CONFIG, turning=False, guarded=True):
    """Return a stage whose places are its attributes."""
    arm = SimpleNamespace(motion=np.zeros((2, 6)), joints=np.zeros(6, JOINT))
    controls = np.zeros(1, CONTROL)
    contacts = np.zeros(CONTACTS, CONTACT)
    controller = SimpleNamespace(
        arm=arm,
        controls=controls,
        contacts=contacts,
        robot=SimpleNamespace(turning=turning),
    )
    stage = Inputs(config, controller, guarded=guarded)
    stage.q, stage.qd = arm.motion
    stage.wrench = controls['wrench'][0]
    stage.variance = contacts['noise_variance']
    return stage


def good(k, random):
    """Return the inputs of an arm that moves slowly, with the sensors' noise."""
    time = k * H
    angle = 1e-3 * np.sin(time)
    speed = 1e-3 * np.cos(time)
    q = HOME + angle + 1e-9 * random.normal(size=6)
    qd = speed + 1e-6 * random.normal(size=6)
    wrench = WrenchInput(time, random.normal(size=6))
    variance = VarianceInput(time - H, 0.2 + random.random(CONTACTS))
    return TickInputs(time, JointInput(time, q, qd), wrench, variance)


def changed(inputs, source, **values):
    reading = getattr(inputs, source)._replace(**values)
    return inputs._replace(**{source: reading})


def put(number):
    """Return a change that puts a number in the first place of a reading."""

    def change(inputs, source):
        name = 'q' if source == 'joints' else source
        values = getattr(getattr(inputs, source), name).copy()
        values[0] = number
        return changed(inputs, source, **{name: values})

    return change


def delayed(time):
    """Return a change of a reading's stamp [s]."""

    def change(inputs, source):
        return changed(inputs, source, stamp=inputs.time + time)

    return change


def without_a_joint(inputs, source):
    return changed(inputs, source, q=[0.0] * 5)


def warm(ticks=20):
    """Return a stage that has found nothing wrong, and what makes the noise."""
    stage = make()
    random = np.random.default_rng(0)
    for k in range(ticks):
        seen = stage.validate(good(k, random))
        assert not seen.causes
        assert not seen.rejected
    return stage, random


FAULTS = [
    ('joints', put(np.nan), 'joints_invalid'),
    ('joints', put(2e3), 'joints_invalid'),
    ('joints', put(HOME[0] + 0.02), 'joints_jump'),
    ('joints', put(HOME[0] - 0.02), 'joints_jump'),
    ('wrench', put(np.nan), 'wrench_invalid'),
    ('wrench', put(-np.inf), 'wrench_invalid'),
    ('wrench', put(100.0), 'wrench_saturated'),
    ('variance', put(np.nan), 'variance_invalid'),
    ('variance', put(-1.0), 'variance_invalid'),
    ('joints', without_a_joint, 'joints_invalid'),
    ('joints', delayed(H), 'joints_stamp'),
    ('wrench', delayed(H), 'wrench_stamp'),
    ('variance', delayed(H), 'variance_stamp'),
    ('joints', delayed(-5 * H), 'joints_stamp'),
    ('wrench', delayed(-5 * H), 'wrench_stamp'),
    ('variance', delayed(-5 * H), 'variance_stamp'),
]


@pytest.mark.parametrize(('source', 'change', 'name'), FAULTS)
def test_fault_of_a_reading_is_named_and_its_numbers_are_not_used(source, change, name):
    stage, random = warm()
    stage.validate(good(20, random))
    places = {'joints': stage.q, 'wrench': stage.wrench, 'variance': stage.variance}
    place = places[source]
    before = place.copy()
    inputs = good(21, random)
    seen = stage.validate(change(inputs, source))
    assert seen.rejected == (name,)
    np.testing.assert_array_equal(place, before)
    if source != 'joints':
        np.testing.assert_array_equal(stage.q, inputs.joints.q)


def with_variance(inputs, variance):
    """Return inputs with the same R [N^2] of every contact."""
    return changed(inputs, 'variance', variance=np.full(CONTACTS, variance))


@pytest.mark.parametrize(('variance', 'used'), [(1e-3, 0.1), (7.0, 7.0), (1e5, 1e3)])
def test_variance_keeps_to_its_limits(variance, used):
    stage, random = warm()
    stage.validate(with_variance(good(20, random), variance))
    np.testing.assert_array_equal(stage.variance, used)


def test_variance_that_is_not_renewed_grows_up_to_its_limit():
    """It is bridged for 3 samples, and 10 % larger with each one after."""
    stage, random = warm()
    stage.validate(with_variance(good(20, random), 7.0))
    variances = []
    for k in range(21, 100):
        stage.validate(good(k, random)._replace(variance=None))
        variances.append(stage.variance[0])
    np.testing.assert_allclose(variances[:3], 7.0)
    growing = 7.0 * 1.1 ** np.arange(1, 77)
    np.testing.assert_allclose(variances[3:], np.minimum(growing, 1e3))


def test_third_identical_reading_is_frozen_and_a_wrench_is_bridged_for_one():
    stage, random = warm()
    inputs = good(20, random)
    results = []
    for k in range(20, 25):
        newer = good(k, random)
        joints = inputs.joints._replace(stamp=newer.time)
        wrench = inputs.wrench._replace(stamp=newer.time)
        same = newer._replace(joints=joints, wrench=wrench)
        results.append(stage.validate(same))
    frozen = ('joints_frozen', 'wrench_frozen')
    rejected = [seen.rejected for seen in results]
    causes = [seen.causes for seen in results]
    assert rejected == [(), (), frozen, frozen, frozen]
    assert causes == [(), (), ('joints_frozen',), frozen, frozen]
    assert stage.sensor_fault == 'frozen'


def test_sensor_is_stale_once_the_last_wrench_is_too_old_to_be_bridged():
    stage, random = warm()
    faults = []
    for k in range(20, 34):
        stage.validate(good(k, random)._replace(wrench=None))
        faults.append(stage.sensor_fault)
    assert faults == [''] * 12 + ['stale'] * 2
    stage.validate(good(34, random))
    assert stage.sensor_fault == ''


def test_wrench_is_frozen_after_as_many_identical_ones_as_are_configured():
    _, _, rejected = sensed([np.ones(6)] * 6, frozen_ticks=5)
    assert rejected == [()] * 4 + [('wrench_frozen',)] * 2


def test_angle_that_wraps_goes_on():
    stage = make(turning=True)
    random = np.random.default_rng(0)
    for k in range(20):
        inputs = good(k, random)
        q = inputs.joints.q
        if k >= 10:
            inputs = changed(inputs, 'joints', q=q - 2.0 * np.pi)
        assert stage.validate(inputs).rejected == ()
        np.testing.assert_allclose(stage.q, q, atol=1e-12)


def swing(k):
    """Return positions and velocities of joints that swing by 0.02 rad at up to 0.2 rad/s."""
    phase = 10.0 * k * H
    q = HOME - 0.02 * np.cos(phase)
    qd = 0.2 * np.sin(phase)
    return q, np.full(6, qd)


def joints_alone(k, q, qd):
    """Return the inputs of joints at a tick, and nothing else."""
    time = k * H
    return TickInputs(time, JointInput(time, q, qd))


def wrench_alone(k, wrench):
    """Return the inputs of a wrench at a tick, and nothing else."""
    time = k * H
    return TickInputs(time, wrench=WrenchInput(time, wrench))


@pytest.mark.parametrize(
    'wrong',
    [
        lambda q, qd, k: np.degrees(qd),
        lambda q, qd, k: 0.02 * qd,
        lambda q, qd, k: -qd,
        lambda q, qd, k: q,
        lambda q, qd, k: qd + 0.3,
        lambda q, qd, k: 0.0 * qd + 0.3,
        lambda q, qd, k: 0.0 * qd + np.inf,
        lambda q, qd, k: np.append(0.0, qd[1:]),
        lambda q, qd, k: swing(k - 60)[1],
    ],
)
@pytest.mark.parametrize('begin', [0, 400])
def test_velocity_that_positions_contradict_is_a_cause_and_is_not_used(wrong, begin):
    stage = make()
    for k in range(begin):
        seen = stage.validate(joints_alone(k, *swing(k)))
        assert not seen.rejected
    causes = []
    for k in range(begin, begin + 200):
        q, qd = swing(k)
        seen = stage.validate(joints_alone(k, q, wrong(q, qd, k)))
        causes += seen.causes
        if 'joints_velocity' in seen.causes:
            within = 0.2
            if k > begin + 20:
                within = 0.02
            np.testing.assert_allclose(stage.qd, qd, atol=within)
        np.testing.assert_array_equal(stage.q, q)
    assert 'joints_velocity' in causes


def test_velocities_are_believed_again_once_they_agree_while_joints_move():
    """They have the opposite sign at first; at rest any scale agrees."""
    stage = make()
    for k in range(100):
        q, qd = swing(k)
        stage.validate(joints_alone(k, q, -qd))
    assert not np.array_equal(stage.qd, -qd)
    turning_point, _ = swing(157)
    for k in range(100, 400):
        seen = stage.validate(joints_alone(k, turning_point, np.zeros(6)))
        assert k < 250 or 'joints_velocity' not in seen.causes
    for k in range(400, 700):
        q, qd = swing(k - 243)
        seen = stage.validate(joints_alone(k, q, qd))
        assert 'joints_velocity' not in seen.causes
        if k == 415:
            assert not np.array_equal(stage.qd, qd)
    np.testing.assert_array_equal(stage.qd, qd)


@pytest.mark.parametrize('silent', [None, np.zeros(6)])
def test_positions_make_up_for_velocities_that_do_not_come(silent):
    stage = make()
    for k in range(300):
        q, _ = swing(k)
        _, earlier_qd = swing(k - 2)
        seen = stage.validate(joints_alone(k, q, silent))
        assert 'joints' not in ' '.join(seen.causes)
        within = 0.2
        if k > 40:
            within = 3e-3
        np.testing.assert_allclose(stage.qd, earlier_qd, atol=within)


@pytest.mark.parametrize(
    ('times', 'causes'),
    [
        ((20, 19), ('clock_backwards',)),
        ((20, 23), ()),
        ((20, 23, 26), ('clock_rate',)),
        ((20, 20.3, 20.6), ('clock_rate',)),
        ((20, 20), ()),
        ((20, 20, 20), ('clock_rate',)),
    ],
)
def test_fault_of_the_clock_is_named(times, causes):
    """An odd period is one only twice in a row; joints and wrenches come in time."""
    stage, random = warm()
    for tick in times:
        seen = stage.validate(good(tick, random))
    clock = [cause for cause in seen.causes if cause.startswith('clock')]
    assert clock == list(causes)


def sensed(wrenches, **sensor):
    """Return a stage that has got these wrenches, and for each what is passed on and rejected."""
    config = CONFIG.model_copy(update={'sensor': SensorFrontEndConfig(**sensor)})
    stage = make(config)
    passed = []
    rejected = []
    for k, wrench in enumerate(wrenches):
        seen = stage.validate(wrench_alone(k, wrench))
        passed.append(stage.filtered_wrench.copy())
        rejected.append(tuple(x for x in seen.rejected if x.startswith('wrench')))
    return stage, np.array(passed), rejected


@pytest.mark.parametrize(
    ('order', 'axis', 'size'), [(0, 2, 8.0), (0, 4, -1.5), (2, 0, 40.0)]
)
def test_single_wrench_far_from_the_others_is_left_out_and_two_in_a_row_are_taken(
    order, axis, size
):
    random = np.random.default_rng(0)
    signal = 0.05 * random.standard_normal((400, 6))
    struck = signal.copy()
    changed = signal.copy()
    struck[200, axis] += size
    changed[200:, axis] += size
    sensor = {'filter_order': order, 'filter_cutoff': 40.0}
    left_out = [('wrench_outlier',) if k == 200 else () for k in range(400)]
    calm = sensed(signal, **sensor)[1]
    _, passed, rejected = sensed(struck, **sensor)
    assert rejected == left_out
    assert np.abs(passed - calm).max() < 0.3
    stage, passed, rejected = sensed(changed, **sensor)
    assert rejected == left_out
    np.testing.assert_array_equal(stage.raw_wrench, changed[-1])
    if not order:
        np.testing.assert_array_equal(passed[201:], changed[201:])


def outliers(stage, ticks, signal):
    """Return the numbers of the wrenches that are left out as outliers."""
    left_out = []
    for k, (tick, wrench) in enumerate(zip(ticks, signal)):
        seen = stage.validate(wrench_alone(tick, wrench))
        if 'wrench_outlier' in seen.rejected:
            left_out.append(k)
    return left_out


def test_outlier_of_a_wrench_is_not_looked_for_without_guards_and_after_a_gap():
    signal = 0.05 * np.random.default_rng(0).standard_normal((200, 6))
    signal[150] += 20.0
    ticks = np.arange(200)
    after_a_gap = np.where(ticks < 150, ticks, ticks + 5)
    assert outliers(make(guarded=False), ticks, signal) == []
    # The one after it is far from it.
    assert outliers(make(), after_a_gap, signal) in ([], [151])


def test_stage_without_guards_hands_over_what_came():
    """Angles that wrap, jumps and saturated wrenches too; R within its bounds."""
    stage = make(turning=True, guarded=False)
    random = np.random.default_rng(0)
    bounds = CONFIG.noise_variance
    for k in range(40):
        inputs = good(k, random)
        jump = (0.0, 2.0 * np.pi, -0.3)[k % 3]
        inputs = changed(inputs, 'joints', q=inputs.joints.q + jump)
        saturated = inputs.wrench.wrench * 40.0 ** (k % 4)
        inputs = changed(inputs, 'wrench', wrench=saturated)
        inputs = with_variance(inputs, 10.0 ** (k % 9 - 4))
        assert stage.validate(inputs) is ALL_VALID
        np.testing.assert_array_equal(stage.q, inputs.joints.q)
        np.testing.assert_array_equal(stage.qd, inputs.joints.qd)
        np.testing.assert_array_equal(stage.wrench, inputs.wrench.wrench)
        expected = np.clip(inputs.variance.variance, bounds.smallest, bounds.largest)
        np.testing.assert_array_equal(stage.variance, expected)
    stage.validate(good(40, random)._replace(variance=None))
    np.testing.assert_array_equal(stage.variance, CONFIG.initial_noise_variance)


@pytest.mark.parametrize('numbers', [None, 'text', np.zeros(5), [[0.0] * 6], ['a'] * 6])
def test_stage_without_guards_hands_over_no_numbers_for_what_has_none(numbers):
    """So the law says that there is no torque for them."""
    stage = make(guarded=False)
    random = np.random.default_rng(0)
    stage.validate(good(0, random))
    inputs = changed(good(1, random), 'joints', q=numbers)
    assert stage.validate(changed(inputs, 'variance', variance=numbers)) is ALL_VALID
    assert np.isnan(stage.q).all()
    assert np.isnan(stage.variance).all()
    assert stage.validate(good(2, random)) is ALL_VALID
    assert np.isfinite(stage.q).all()


@pytest.mark.parametrize('order', [1, 2])
def test_low_pass_is_scipys_butterworth_from_a_settled_start(order):
    wrench = np.arange(1.0, 7.0)
    signal = np.random.default_rng(0).standard_normal((200, 6))
    signal[0] = 0.0
    b, a = butter(order, 40.0, fs=RATE)
    expected = wrench + lfilter(b, a, signal, axis=0)
    _, passed, _ = sensed(wrench + signal, filter_order=order, filter_cutoff=40.0)
    np.testing.assert_allclose(passed, expected, atol=1e-12)


@pytest.mark.parametrize('order', [1, 2])
def test_low_pass_goes_on_behind_a_missing_number(order):
    wrench = np.arange(1.0, 7.0)
    signal = np.tile(wrench, (30, 1))
    signal[20] = np.nan
    _, passed, _ = sensed(
        signal, frozen_ticks=0, filter_order=order, filter_cutoff=40.0
    )
    assert np.isnan(passed[20]).all()
    others = np.delete(passed, 20, axis=0)
    np.testing.assert_allclose(others, [wrench] * 29, rtol=1e-12)


@pytest.mark.parametrize('order', [1, 2])
@pytest.mark.parametrize('cutoff', [15.0, 125.0, 240.0])
def test_filter_delay_is_the_group_delay_at_rest(order, cutoff):
    config = SensorFrontEndConfig(filter_order=order, filter_cutoff=cutoff)
    delay = config.filter_delay(RATE)
    low_pass = butter(order, cutoff, fs=RATE)
    # scipy cannot divide where a zero of the filter lies; 0 Hz is far from it.
    _, samples = group_delay(low_pass, w=[1e-3], fs=RATE)
    assert delay == pytest.approx(samples[0] / RATE, rel=1e-4)


def test_delay_of_the_low_pass_is_in_the_controllers_model():
    """T_d of 6 ms and 3 periods of low-pass: as many delay states as 12 ms."""
    cutoff = RATE / np.pi * np.arctan(1 / 6)
    filtered = controller_config(sensor={'filter_order': 1, 'filter_cutoff': cutoff})
    later = controller_config(force={'input_delay': 0.012})
    assert filtered.loop_delay == pytest.approx(0.006 + 3 / RATE)
    design = make_force_laws(filtered)['observer']['design']
    expected = make_force_laws(later)['observer']['design']
    assert design['states'].tolist() == [2 + 6 + 1] * 2
    np.testing.assert_allclose(design['feedback'], expected['feedback'], rtol=1e-6)


def test_low_pass_that_is_later_than_the_model_holds_is_refused():
    with pytest.raises(
        ConfigError, match='force.input_delay: .*filter_cutoff .* got 0.051'
    ):
        controller_config(sensor={'filter_order': 2, 'filter_cutoff': 5.0})
