"""What recorded force steps say of contacts, against the plant that they were recorded on."""

from dataclasses import replace
import math

from multicontact_control.cli import app
from multicontact_control.errors import RunError
from multicontact_control.experiment import contact_identification
from multicontact_control.experiment.closed_loop import run_in_process
from multicontact_control.experiment.contact_identification import (
    ContactSignals,
    identify_contacts,
    noise_at_rest,
    read_recording,
    show,
)
from multicontact_control.experiment.scenario import resolve
from multicontact_control.experiment.summary import summarise
from multicontact_control.files import finite, read_json, write_json
import numpy as np
import pytest
from typer.testing import CliRunner

NOISE = 0.1  # N, per axis


@pytest.fixture(scope='module')
def recorded():
    setup = resolve('quick', plant='rigid', seed=3, duration=6.0, plant_overrides={
        'surfaces': {'table': {'stiffness': 4000.0, 'damping': 20.0},
                     'board': {'stiffness': 9000.0, 'damping': 50.0}},
        'sensor': {'force_noise_std': NOISE, 'torque_noise_std': 0.0, 'quantise': False}})
    data = run_in_process(setup, supervised=True).data
    return setup, data, identify_contacts(data, setup.controller, setup.urdf_dir)


@pytest.mark.slow
@pytest.mark.parametrize(('contact', 'stiffness', 'damping'), [
    ('table', 4000.0, 20.0), ('board', 9000.0, 50.0)])
def test_surface_is_found_within_its_errors(recorded, contact, stiffness, damping):
    found = recorded[2][contact]
    assert found['explained'] > 0.95
    for name, true in (('stiffness_n_m', stiffness), ('damping_n_s_m', damping),
                       ('tool_mass_kg', 0.491)):
        assert abs(found[name]['value'] - true) < 4.0 * found[name]['std'], name
    assert found['stiffness_n_m']['std'] < 0.05 * stiffness


@pytest.mark.slow
def test_surface_under_an_edge_is_found_by_its_force_and_not_by_its_couple():
    setup = resolve('edge', plant='rigid', seed=3, duration=6.0)
    data = run_in_process(setup, supervised=True).data
    found = identify_contacts(data, setup.controller, setup.urdf_dir)
    assert [*found] == ['edge']
    stiffness = found['edge']['stiffness_n_m']
    assert abs(stiffness['value'] - 6000.0) < 4.0 * stiffness['std'] + 300.0


def test_error_that_is_not_known_is_written_as_such(tmp_path, monkeypatch):
    value = {'value': 0.003, 'std': math.inf}
    contact = {**dict.fromkeys(('stiffness_n_m', 'damping_n_s_m', 'friction', 'tool_mass_kg',
                                'noise_variance_n2', 'explained')), 'samples': 1, 'delay_s': value}
    monkeypatch.setattr(contact_identification, 'read_recording', lambda *_: (None, None, None))
    monkeypatch.setattr(contact_identification, 'identify_contacts', lambda *_: {'edge': contact})
    result = CliRunner().invoke(app, ['identify', '.', '--out', str(tmp_path / 'found.json')])
    assert result.exit_code == 0, result.output
    assert 'edge: 1 sample\n' in result.output and 'delay: 3.00 +- inf ms' in result.output
    assert read_json(tmp_path / 'found.json')['edge']['delay_s'] == {
        'value': 0.003, 'std': None}


@pytest.mark.slow
def test_more_delay_of_the_actuator_is_found(recorded):
    """Three periods more."""
    setup, _, found = recorded
    late = resolve('quick', plant='rigid', seed=3, duration=6.0, plant_overrides={
        **setup.plant.model_dump(), 'actuator_delay_ticks': 4})
    data = run_in_process(late, supervised=True).data
    later = identify_contacts(data, late.controller, late.urdf_dir)
    for name in found:
        change = later[name]['delay_s']['value'] - found[name]['delay_s']['value']
        assert change == pytest.approx(0.006, abs=0.002)


@pytest.mark.slow
def test_noise_is_that_of_the_sensor_in_the_direction_of_the_contact(recorded):
    """A force alone has the noise of its axis; lever arms add to it."""
    for contact in recorded[2].values():
        assert NOISE ** 2 < 1.2 * contact['noise_variance_n2']['value'] < 4.0 * NOISE ** 2


@pytest.mark.parametrize('size', [60, 400])
def test_error_of_the_noise_is_that_of_many_recordings(size):
    """White noise in 2000 recordings of one contact at rest: the scatter of what is found."""
    random = np.random.default_rng(4)
    rest = np.zeros(size)
    found = [noise_at_rest(ContactSignals(
        NOISE * random.normal(size=size), rest + 10.0, rest, rest, rest, rest, rest))
        for _ in range(2000)]
    values, errors = (np.array([each[name] for each in found]) for name in ('value', 'std'))
    assert values.mean() == pytest.approx(NOISE ** 2, rel=0.05)
    assert errors.mean() == pytest.approx(values.std(), rel=0.07)


@pytest.mark.slow
def test_wrench_that_the_controller_works_with_is_read(recorded):
    """A driver that publishes only the filtered one, which is late by the low-pass."""
    setup, data, whole = recorded
    filtered = replace(data, wrench=np.full_like(data.wrench, np.nan))
    config = setup.controller.model_copy(update={'wrench_input': 'filtered'})
    found = identify_contacts(filtered, config, setup.urdf_dir)
    for name, contact in found.items():
        assert contact['stiffness_n_m']['value'] == pytest.approx(
            whole[name]['stiffness_n_m']['value'], rel=0.1)


@pytest.mark.slow
def test_run_that_lacks_the_wrench_is_refused_by_name(recorded, tmp_path):
    setup, data, _ = recorded
    setup.write(tmp_path / 'config')
    write_json(tmp_path / 'summary.json', finite(summarise(
        data, setup, mode='in_process', timing={})))
    data.save(tmp_path)
    assert read_recording(tmp_path, None)[0].ticks == data.ticks
    replace(data, wrench=np.full_like(data.wrench, np.nan)).save(tmp_path)
    with pytest.raises(RunError, match=r'expected the wrench \(ft_sensor/wrench\), found none'):
        read_recording(tmp_path, None)


@pytest.mark.slow
def test_recording_without_steps_is_refused(recorded):
    setup, data, _ = recorded
    with pytest.raises(RunError, match='expected force steps'):
        identify_contacts(data.truncated(300), setup.controller, setup.urdf_dir)


@pytest.mark.slow
def test_gaps_of_a_recording_are_left_out(recorded):
    setup, data, whole = recorded
    q = data.q.copy()
    q[::50] = np.nan
    found = identify_contacts(replace(data, q=q), setup.controller, setup.urdf_dir)
    assert found['table']['samples'] < whole['table']['samples']


@pytest.mark.slow
def test_what_is_not_known_is_said(recorded):
    found = {'table': {**recorded[2]['table'], 'delay_s': None}}
    text = show(found)
    assert 'delay: not known' in text
    assert '+-' in text
