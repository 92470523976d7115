"""The programs of `examples/` do what their first lines say."""

import ast
from importlib import import_module
import os
import re
import sys

from multicontact_control.commissioning.law_report import (
    closed_loop_matrix,
    design_for_range,
)
from multicontact_control.config import ForceConfig, NoiseEstimatorConfig
from multicontact_control.force.laws.design import LoopModel
from multicontact_control.judging.judged_run import simulate_run
from multicontact_control.judging.results import load_run
from multicontact_control.runs.scenario import resolve
import numpy as np
import pandas as pd
import pytest
from ros_graph import end_of, obedient_graph, ROOT, start_python

FOLDER = ROOT / 'examples'
PROGRAMS = sorted(path.name for path in FOLDER.glob('*.py'))
NUMBER = r'(-?\d+\.\d+)'
SLIDING = 9.0  # s of the scenario `quick`, at which its motion has begun


@pytest.fixture
def load_example(monkeypatch, registries):
    """Return what imports an example, as a program beside it would."""
    monkeypatch.syspath_prepend(FOLDER)
    loaded = []

    def load(name):
        loaded.append(name)
        return import_module(name)

    yield load
    for name in loaded:
        del sys.modules[name]


def read_rows(text):
    """Return the numbers of each row of a printed table, by the words in front of them."""
    rows = {}
    for line in text.splitlines():
        numbers = re.findall(NUMBER, line)
        if numbers:
            rows[tuple(line.split()[: -len(numbers)])] = [*map(float, numbers)]
    return rows


@pytest.mark.parametrize('name', PROGRAMS)
def test_example_is_short_names_its_command_and_is_in_the_readme(name):
    text = (FOLDER / name).read_text(encoding='utf-8')
    assert len(text.splitlines()) <= 80
    assert f'python examples/{name}' in ast.get_docstring(ast.parse(text))
    assert f'(examples/{name})' in (ROOT / 'README.md').read_text(encoding='utf-8')


def test_own_force_law_has_its_three_poles_where_it_places_them(load_example):
    law = load_example('own_force_law').LAW
    period = 1e-5  # s, so short that the loop is nearly the continuous one
    model = LoopModel(6000.0, damping_rate=100.0, input_delay=0.0, period=period)
    placed = law.design(model, ForceConfig(time_constant=0.02))
    loop = closed_loop_matrix(placed, model)
    rates = (loop - np.eye(3)) / period
    # Not the poles themselves: three equal ones move by the cube root of a rounding.
    np.testing.assert_allclose(np.poly(rates), np.poly([-25.0] * 3), rtol=1e-2)


def test_own_force_law_is_designed_for_a_range_as_the_laws_of_the_package(load_example):
    load_example('own_force_law')
    designed = design_for_range(
        'placed', stiffness=(2000.0, 8000.0), input_delay=0.006, noise_variance=0.6
    )
    assert designed.stiffest_ratio >= 2.0
    assert designed.values['time_constant'] > 0.0


@pytest.mark.slow
def test_own_force_law_holds_the_forces_beside_the_observer(load_example, capsys):
    load_example('own_force_law').main(SLIDING)
    rows = read_rows(capsys.readouterr().out)
    assert {law for law, _ in rows} == {'aob', 'placed'}
    for at_rest, sliding in rows.values():
        assert 0.0 < at_rest < 0.2 < sliding < 1.5
    assert rows['placed', 'table'] != rows['aob', 'table']


def test_own_noise_estimator_finds_white_noise_whatever_single_outliers(load_example):
    estimator = load_example('own_noise_estimator').MedianDeviation(
        NoiseEstimatorConfig(
            estimator='median_deviation', contact_names=('table',), window=2000
        )
    )
    forces = 10.0 + 0.8 * np.random.default_rng(0).standard_normal(2000)
    forces[::50] = 100.0
    for force in forces:
        variance = estimator.update(np.array([force]))
    assert variance == pytest.approx(0.64, rel=0.1)


@pytest.mark.slow
def test_own_noise_estimator_feeds_the_observers(load_example, capsys):
    load_example('own_noise_estimator').main(SLIDING)
    rows = read_rows(capsys.readouterr().out)
    assert {name for name, _ in rows} == {'lead_window', 'median_deviation'}
    for at_rest, sliding, error in rows.values():
        assert 0.1 < at_rest < sliding
        assert error < 1.5


@pytest.mark.slow
def test_own_study_finds_the_hasty_loop_faster(load_example, tmp_path, capsys):
    example = load_example('own_study')
    example.main(tmp_path, example.make_study(duration=5.0, seeds=1))
    frame = pd.read_csv(tmp_path / 'study.csv')
    assert len(frame) == 6
    stiff = frame[frame['plant.surfaces.board.stiffness'] == 6000.0]
    rise = stiff.set_index('pace')['rise_s']
    assert rise['hasty'] < rise['usual'] < rise['calm']
    assert 'rise_s' in capsys.readouterr().out


@pytest.mark.nightly
def test_learnt_policy_wipes_better_than_any_constant_force(tmp_path):
    picture = tmp_path / 'curve.png'
    process = start_python(FOLDER / 'learn_to_wipe.py', picture)
    output, errors = process.communicate(timeout=3600)
    assert process.returncode == 0, errors
    rows = read_rows(re.sub('[:,]', '', output).replace('worst', ''))
    constant = rows['constant', 'mean']
    policy = rows['policy', 'mean']
    assert policy[0] > constant[0] and policy[1] > constant[1]
    assert picture.read_bytes().startswith(b'\x89PNG')


@pytest.mark.slow
def test_run_is_read_and_drawn(load_example, tmp_path, capsys):
    summary = simulate_run(resolve('quick', preset='best', duration=11.0), tmp_path)
    capsys.readouterr()
    load_example('read_a_run').main(tmp_path)
    text = capsys.readouterr().out
    assert f'{summary["verdict"]}, {load_run(tmp_path).data.ticks} samples' in text
    for name, contact in summary['contacts'].items():
        (error,) = re.findall(f'{name}: {NUMBER} N rms', text)
        assert 0.0 < float(error) < 2.0 * contact['moving']['true_error_rms_n']
    passes = pd.read_csv(tmp_path / 'passes.csv')
    assert len(re.findall(r'^ *\d+ +(?:table|board) ', text, re.MULTILINE)) == len(
        passes
    )
    assert (tmp_path / 'own_figure.png').read_bytes().startswith(b'\x89PNG')


@pytest.fixture(scope='module')
def run_beside_graph(tmp_path_factory):
    """Return what runs an example beside a simulated arm that obeys commands."""
    folder = tmp_path_factory.mktemp('graph')
    # Faster than real time it would not wait for a program whose turn comes late.
    with obedient_graph(folder, namespace='', speed=0.5) as domain_id:

        def run(name, *arguments):
            environment = {
                **os.environ,
                'PYTHONPATH': str(ROOT),
                'ROS_DOMAIN_ID': str(domain_id),
            }
            process = start_python(FOLDER / name, *arguments, env=environment)
            output, errors = end_of(process)
            assert process.returncode == 0, errors
            return output

        yield domain_id, run


@pytest.mark.ros
@pytest.mark.slow
def test_arm_presses_slides_and_comes_back(run_beside_graph):
    domain_id, run = run_beside_graph
    output = run('press_and_slide.py', domain_id)
    rows = {}
    for line in output.splitlines():
        rows[line.split()[0]] = [*map(float, re.findall(NUMBER, line))]
    for name, table in (('pressed', 10.0), ('stronger', 15.0)):
        _, *forces = rows[name][:3]
        assert forces == pytest.approx([table, 10.0], abs=1.5)
    x = {name: row[3] for name, row in rows.items() if len(row) > 3}
    assert x['slid'] - x['pressed'] == pytest.approx(0.08, abs=0.006)
    assert x['back'] == pytest.approx(x['pressed'], abs=0.006)


@pytest.mark.ros
@pytest.mark.slow
def test_sine_of_force_is_followed(run_beside_graph):
    _, run = run_beside_graph
    output = run('sine_of_force.py')
    mean, amplitude = map(float, re.findall(f'{NUMBER} N[,]? ?(?:of)?', output)[:2])
    assert mean == pytest.approx(10.0, abs=0.2)
    assert amplitude == pytest.approx(3.0, rel=0.1)
    (delay,) = re.findall(r'delay (\d+) ms', output)
    assert 0 < int(delay) < 150
