"""The benchmark in its short form: what it prints, and ratios with a wide margin."""

import json
import os
from pathlib import Path
import subprocess
import sys

from multicontact_control.experiment.bench.scaling import bench_scaling
from multicontact_control.experiment.bench.timing import load_notes, noise_notes, spread
import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
MARGIN = 2.0

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def result():
    """Return what `multicontact bench --json` prints, without the graph."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))
    done = subprocess.run(
        [sys.executable, '-m', 'multicontact_control.cli', 'bench', '--json', '--quick',
         '--no-graph', '--ticks', '500'],
        env={**os.environ, 'PYTHONPATH': path}, capture_output=True, text=True, timeout=300,
        check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)  # one object and nothing else


def test_bench_says_what_it_promises(result):
    assert set(result['ratios']) == {
        'tick_to_dynamics', 'supervised_tick_to_dynamics', 'plant_to_pybullet',
        'latency_to_echo'}
    for name in ('tick_us', 'supervised_tick_us'):
        assert set(result[name]) == {'p50', 'p99', 'p999', 'max'}
    assert result['in_process_realtime_factor'] > 0.0
    assert result['supervised_in_process_realtime_factor'] > 0.0
    assert {'processor', 'cores', 'trustworthy'} <= set(result['machine'])
    assert result['lockstep_realtime_factor'] is None
    assert any(note.startswith('graph:') for note in result['notes'])
    for name in ('tick', 'supervised_tick'):
        assert sum(result[name]['shares'].values()) == pytest.approx(1.0, abs=0.3)
    assert set(result['cold_start']) == {'import_s', 'construct_s', 'process_s'}


def test_tick_is_near_its_floor(result):
    """Five times the floor when it was measured, from the sample to the torque."""
    assert result['ratios']['tick_to_dynamics'] < 5.0 * MARGIN


def test_supervised_tick_is_near_its_floor(result):
    """Seven times the floor and less than twice the bare tick, when it was measured."""
    assert result['ratios']['supervised_tick_to_dynamics'] < 7.0 * MARGIN
    law, supervised = (result[name]['ratio'] for name in ('tick', 'supervised_tick'))
    assert supervised < 2.0 * law * MARGIN


def test_plant_is_near_its_floor(result):
    assert result['ratios']['plant_to_pybullet'] < 3.0 * MARGIN


def test_tick_time_grows_at_most_linearly(result):
    times = result['scaling']['contacts_us']
    assert times['6'] < 6 * times['1']
    joints = result['scaling']['joints_us']
    assert joints['14'] < 14 / 6 * joints['6'] * MARGIN
    assert result['scaling']['order_us']['3'] < MARGIN * result['scaling']['order_us']['0']


def test_scaling_covers_what_it_should():
    scaling = bench_scaling(100)
    assert list(scaling['contacts_us']) == ['1', '2', '3', '4', '5', '6']
    assert list(scaling['joints_us']) == ['6', '7', '14']
    assert list(scaling['order_us']) == ['0', '1', '2', '3']


def test_noise_is_noticed():
    quiet = [np.full(1000, 3.0), np.full(1000, 3.1)]
    assert noise_notes(quiet) == []
    tails = np.full(1000, 3.0)
    tails[::50] = 30.0
    assert 'p99' in noise_notes([tails, tails])[0]
    assert 'between repeats' in noise_notes([np.full(1000, 3.0), np.full(1000, 4.0)])[0]
    assert load_notes(0.5, 2) == [] == load_notes(None, 2)
    assert 'load of 6.0 on 2 cores' in load_notes(6.0, 2)[0]


def test_spread_is_relative_to_the_median():
    assert spread([1.0, 2.0, 3.0]) == 1.0
