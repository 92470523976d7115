"""The stiffness found on-line: the regression, its standard error, and the model that follows."""

from force_loop import design_force_loop, H
from multicontact_control.config import ForceConfig
from multicontact_control.force.force_law import FORCE_LAW
from multicontact_control.force.observer import design_observer, make_observers
from multicontact_control.force.stiffness import (
    add_fit_sample,
    estimate_stiffness,
    FIT_SPACE,
    follow_stiffness,
    set_up_stiffness,
    STIFFNESS,
    use_model_stiffness,
)
from multicontact_control.records import CONTACT, CONTROL
import numpy as np
import pytest

SPACE = np.zeros(1, dtype=FIT_SPACE)[0]


def stiffness_of(k=6000.0, delay=0.006, mass=0.5, period=H, **values):
    """Return the record of an adaptive stiffness, and its observer."""
    config = ForceConfig(damping_rate=100.0, **values)
    loop = design_force_loop(k, 100.0, delay, period)
    observer = make_observers([design_observer(loop)])[0]
    record = np.zeros(1, dtype=STIFFNESS)[0]
    set_up_stiffness(
        record,
        loop.plant,
        k,
        config,
        period=period,
        tool_mass=mass,
        ratio_limits=np.linspace(5.0, 1.0, 8).tolist(),
    )
    return record, observer


def follow(observer, record):
    """Let the model follow the fits as they are: nothing is felt."""
    laws, contacts, controls = (
        np.zeros(1, dtype=dtype) for dtype in (FORCE_LAW, CONTACT, CONTROL)
    )
    laws['observer'], laws['stiffness'], controls['measured'] = observer, record, True
    follow_stiffness(laws, contacts, 0, controls[0], 0.0, SPACE)
    for part, changed in (
        (observer, laws['observer'][0]),
        (record, laws['stiffness'][0]),
    ):
        for name in part.dtype.names:
            part[name] = changed[name]


@pytest.mark.parametrize('delay', [0.0, 0.001, 0.002, 0.0037, 0.006, 0.0071])
def test_feedback_of_another_stiffness_is_that_of_ackermann(delay):
    """Of another stiffness, and with other poles; P04 eq. 36 is the reference."""
    record, observer = stiffness_of(delay=delay, mass=0.0)
    for k in (300.0, 20_000.0, 6000.0):
        use_model_stiffness(observer, record, k, 0.0)
        wanted = make_observers([design_observer(design_force_loop(k, 100.0, delay))])[
            'design'
        ][0]
        for name in ('Phi_n', 'Gamma', 'feedback'):
            np.testing.assert_allclose(
                observer['design'][name],
                wanted[name],
                rtol=1e-6,
                atol=1e-9 * np.abs(wanted[name]).max(),
            )


def test_poles_are_limited_by_tool_and_surface():
    record, observer = stiffness_of()
    use_model_stiffness(observer, record, 300.0, 20.0)
    design = observer['design']
    loop = design['Phi_n'][:5, :5] - np.outer(
        design['Gamma'][:5], design['feedback'][:5]
    )
    poles = np.sort(-np.log(np.sort(np.abs(np.linalg.eigvals(loop)))[-2:]) / H)
    np.testing.assert_allclose(
        poles, [300.0 / 20.0, np.sqrt(0.8 * 300.0 / 0.5)], rtol=1e-4
    )


def signals(k, c, mu, mass, seed=1, count=150, noise=0.0):
    """Return samples of a surface that is pressed and let go: z, v, w and what is measured."""
    random = np.random.default_rng(seed)
    t = H * np.arange(count)
    depth = 2e-3 * (1.0 - np.cos(2.0 * np.pi * 5.0 * t)) + 3e-4 * np.sin(
        2.0 * np.pi * 9.0 * t
    )
    speed = np.gradient(depth, H)
    others = 10.0 * speed / np.sqrt(speed**2 + 0.003**2)
    alpha = k * depth + c * speed + mu * others + mass * np.gradient(speed, H)
    return np.column_stack(
        [depth, speed, others, alpha + noise * random.standard_normal(count)]
    )


def fit_to(samples):
    """Return the slow fit to samples that are all accepted."""
    record, _ = stiffness_of()
    fit = record['slow']
    for record['depth'], record['speed'], friction, alpha in samples:
        add_fit_sample(record, fit, friction, alpha, True, SPACE)
    return fit


@pytest.mark.parametrize(
    ('k', 'c', 'mu'), [(300.0, 30.0, 0.1), (6000.0, 0.0, 0.0), (60_000.0, 50.0, 0.3)]
)
def test_fit_recovers_stiffness_damping_and_friction(k, c, mu):
    fit = fit_to(signals(k, c, mu, 0.5))
    assert fit['k'] == pytest.approx(k, rel=0.03)
    assert fit['mu'] == pytest.approx(mu, abs=0.03)
    assert fit['c'] == pytest.approx(c, abs=max(0.1 * c, 0.002 * k))
    assert fit['share'] > 0.99


def test_fit_error_is_that_of_repeated_fits():
    values, errors = [], []
    for seed in range(60):
        fit = fit_to(signals(6000.0, 30.0, 0.1, 0.5, seed=seed, noise=0.3))
        values.append(float(fit['k'])), errors.append(float(fit['k_std']))
    assert 0.5 < np.std(values) / np.median(errors) < 2.0


def test_fit_takes_samples_after_a_touch_or_a_step_alone():
    record, _ = stiffness_of()
    weights = []
    for k, sample in enumerate(signals(6000.0, 0.0, 0.0, 0.5, count=600)):
        estimate_stiffness(
            record, 5.0 + sample[3], 15.0 if k > 400 else 10.0, sample[1], 0.0, SPACE
        )
        weights.append(float(record['slow']['weight']))
    assert weights[149] > 10.0
    assert weights[160] == weights[400]
    assert weights[420] != weights[400]


def test_model_follows_at_its_rates_within_its_range():
    record, observer = stiffness_of(adaptive={'lowest': 1000.0, 'highest': 50_000.0})
    fit, used = record['slow'], []
    for target, ticks in ((300.0, 200), (200_000.0, 60)):
        fit['k'], fit['share'], fit['k_std'] = target, 1.0, 0.0
        for _ in range(ticks):
            follow(observer, record)
            used.append(float(record['k']))
    steps = np.diff(np.log(used))
    assert steps.min() >= -H / 0.02 - 1e-12
    assert steps.max() <= H / 0.004 + 1e-12
    assert (min(used), max(used)) == (pytest.approx(1000.0), pytest.approx(50_000.0))


def test_force_does_not_jump_when_the_model_changes():
    record, observer = stiffness_of()
    observer['x_est'][:2], observer['P'][0, 1], observer['P'][1, 1] = (
        (10.0, 40.0),
        2.0,
        3.0,
    )
    use_model_stiffness(observer, record, 12_000.0, 24.0)
    assert observer['x_est'][:2].tolist() == [10.0, 80.0]
    assert (observer['P'][0, 1], observer['P'][1, 1]) == (4.0, 12.0)
    assert observer['design']['damping_time'] == pytest.approx(24.0 / 12_000.0)
