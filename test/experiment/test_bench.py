"""The benchmark in its short form: what it prints, and ratios with a wide margin."""

import json
import os
from pathlib import Path
import subprocess
import sys
import time

from multicontact_control.experiment.bench import timing
from multicontact_control.experiment.bench.run import print_bench
from multicontact_control.experiment.bench.scaling import bench_scaling
from multicontact_control.experiment.bench.timing import noise_notes, share_notes, spread
import numpy as np
import pytest
from rich.console import Console

ROOT = Path(__file__).parents[2]
MARGIN = 2.0

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def result():
    """Return what `multicontact bench --json` prints, without the graph and where TSID is not."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get('PYTHONPATH')]))
    done = subprocess.run(
        [sys.executable, '-m', 'multicontact_control.cli', 'bench', '--json', '--quick',
         '--no-graph', '--ticks', '500', '--against', 'tsid', '--tsid-python', 'no/python'],
        env={**os.environ, 'PYTHONPATH': path}, capture_output=True, text=True, timeout=300,
        check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)  # one object and nothing else


def test_bench_says_what_it_promises(result):
    assert set(result['ratios']) == {
        'tick_to_dynamics', 'supervised_tick_to_dynamics', 'plant_to_pybullet',
        'latency_to_echo', 'lockstep_to_floor', 'law_to_tsid'}
    for name in ('tick_us', 'supervised_tick_us'):
        assert set(result[name]) == {'p50', 'p99', 'p999', 'max'}
    assert result['in_process_realtime_factor'] > 0.0
    assert result['supervised_in_process_realtime_factor'] > 0.0
    assert {'processor', 'cores', 'trustworthy'} <= set(result['machine'])
    assert result['lockstep_realtime_factor'] is None
    assert any(note.startswith('graph:') for note in result['notes'])
    assert result['ratios']['law_to_tsid'] is result['tsid'] is None
    missing = "tsid: not found, 'no/python': No such file or directory; python3 -m venv"
    assert any(note.startswith(missing) for note in result['notes'])
    assert {'paper', 'best', 'adaptive', 'laws/dob'} < set(result['laws'])
    assert all(law['ratio'] > 0.5 for law in result['laws'].values())
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
    """2.3 times the floor when it was measured."""
    assert result['ratios']['plant_to_pybullet'] < 2.3 * MARGIN


def test_tick_time_grows_at_most_linearly(result):
    times = result['scaling']['columns_us']
    assert times['6'] < 6 * times['1']
    joints = result['scaling']['joints_us']
    assert joints['14'] < 14 / 6 * joints['6'] * MARGIN
    assert result['scaling']['order_us']['3'] < MARGIN * result['scaling']['order_us']['0']


def test_scaling_covers_what_it_should():
    scaling = bench_scaling(100)
    assert list(scaling['columns_us']) == ['1', '2', '3', '4', '5', '6', '12']
    assert list(scaling['joints_us']) == ['6', '7', '14']
    assert list(scaling['order_us']) == ['0', '1', '2', '3']


def test_noise_is_noticed():
    quiet = [np.full(1000, 3.0), np.full(1000, 3.1)]
    assert noise_notes(quiet) == []
    tails = np.full(1000, 3.0)
    tails[::50] = 30.0
    assert 'p99' in noise_notes([tails, tails])[0]
    assert 'between repeats' in noise_notes([np.full(1000, 3.0), np.full(1000, 4.0)])[0]
    assert share_notes(None) == [] == share_notes(0.05)
    assert "others took 40% of all cores' time" in share_notes(0.4)[0]


def test_what_others_take_is_neither_idle_nor_ours(monkeypatch):
    spent = iter([(100.0, 40.0, 10.0), (200.0, 100.0, 30.0), None])
    monkeypatch.setattr(timing, '_processor_time', lambda: next(spent))
    bystanders = timing.Bystanders()
    assert bystanders.share() == 0.2
    assert bystanders.share() is None


@pytest.mark.skipif(not Path('/proc/stat').exists(), reason='nothing tells what others take')
def test_process_that_nobody_waits_for_is_one_of_the_others():
    busy = 'import time; end = time.monotonic() + 1.0\nwhile time.monotonic() < end: pass'
    start = (f'import subprocess, sys, os; subprocess.Popen([sys.executable, "-c", {busy!r}]); '
             'os._exit(0)')
    bystanders = timing.Bystanders()
    subprocess.run([sys.executable, '-c', start], check=True)
    time.sleep(1.0)
    assert 0.2 / os.cpu_count() < bystanders.share() <= 1.0


def test_time_of_grandchildren_is_ours_while_their_parent_lives():
    """As of nodes, which a server forks that outlives their graph."""
    busy = 'import time\nwhile time.process_time() < 1.0: pass'
    start = (f'import subprocess, sys; subprocess.run([sys.executable, "-c", {busy!r}]); '
             'print("done", flush=True); sys.stdin.read()')
    before = timing._own_time()
    with subprocess.Popen([sys.executable, '-c', start], stdin=subprocess.PIPE,
                          stdout=subprocess.PIPE) as child:
        assert child.stdout.readline() == b'done\n'
        assert timing._own_time() - before > 0.9


@pytest.mark.parametrize('trustworthy', [True, False])
def test_table_says_whether_to_believe_it(result, trustworthy):
    result = {**result, 'machine': {**result['machine'], 'trustworthy': trustworthy}}
    with (console := Console(width=200)).capture() as capture:
        print_bench(result, console)
    first, *_, last = capture.get().strip().splitlines()
    for line in (first, last):
        assert ('not to be believed' in line) is not trustworthy


def test_spread_is_relative_to_the_median():
    assert spread([1.0, 2.0, 3.0]) == 1.0
