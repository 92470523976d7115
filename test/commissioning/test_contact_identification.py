"""What recorded force steps say of contacts, against the plant that they were recorded on."""

from dataclasses import replace

from canonical_runs import run_of
from multicontact_control.commissioning.contact_identification import (
    ContactSignals,
    find_noise_at_rest,
    identify_contacts,
)
from multicontact_control.errors import RunError
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest

NOISE = 0.1  # N, per axis
SURFACES = {
    'table': {'stiffness': 4000.0, 'damping': 20.0},
    'board': {'stiffness': 9000.0, 'damping': 50.0},
}


def recorded(**plant):
    """Return a setup, its recording and what is identified from it."""
    sensor = {'force_noise_std': NOISE, 'torque_noise_std': 0.0, 'quantise': False}
    setup = resolve(
        'quick',
        plant='rigid',
        seed=3,
        duration=6.0,
        plant_overrides={'surfaces': SURFACES, 'sensor': sensor, **plant},
    )
    data = run_of(setup).data
    return setup, data, identify_contacts(data, setup)


@pytest.fixture(scope='module')
def recording():
    return recorded()


@pytest.mark.parametrize('contact', ['table', 'board'])
def test_surface_is_identified_within_its_errors(recording, contact):
    _, _, estimates = recording
    estimate = estimates[contact]
    true = SURFACES[contact]
    assert estimate['explained'] > 0.95
    for name, value in (
        ('stiffness_n_m', true['stiffness']),
        ('damping_n_s_m', true['damping']),
        ('tool_mass_kg', 0.491),
    ):
        found = estimate[name]
        assert found['value'] == pytest.approx(value, abs=2.0 * found['std']), name
    assert estimate['stiffness_n_m']['std'] < 0.1 * true['stiffness']
    # A force alone has the noise of its axis; lever arms add to it.
    assert NOISE**2 < 1.2 * estimate['noise_variance_n2']['value'] < 4.0 * NOISE**2


def test_more_delay_of_the_actuator_is_identified(recording):
    """Three periods more."""
    _, _, estimates = recording
    _, _, later_estimates = recorded(actuator_delay_ticks=4)
    for name, estimate in estimates.items():
        later = later_estimates[name]['delay_s']['value']
        change = later - estimate['delay_s']['value']
        assert change == pytest.approx(0.006, abs=0.002)


def test_error_of_the_noise_is_that_of_many_recordings():
    """White noise in 2000 recordings of one contact at rest: the scatter of what is found."""
    random = np.random.default_rng(4)
    rest = np.zeros(200)
    values = []
    errors = []
    for _ in range(2000):
        noise = NOISE * random.normal(size=200)
        found = find_noise_at_rest(ContactSignals(noise, rest + 10.0, *[rest] * 5))
        values.append(found['value'])
        errors.append(found['std'])
    assert np.mean(values) == pytest.approx(NOISE**2, rel=0.05)
    assert np.mean(errors) == pytest.approx(np.std(values), rel=0.07)


def test_gaps_are_left_out(recording):
    setup, data, whole = recording
    q = data.q.copy()
    q[::50] = np.nan
    contacts = identify_contacts(replace(data, q=q), setup)
    assert contacts['table']['samples'] < whole['table']['samples']


def test_recording_without_steps_is_refused(recording):
    setup, data, _ = recording
    with pytest.raises(RunError):
        identify_contacts(data.part(0, 300), setup)
