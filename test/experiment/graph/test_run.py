"""The real graph: processes, middleware, bag; run to its end, interrupted, and with a death."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import threading

from multicontact_control.cli.run import Composed
from multicontact_control.errors import RunError
from multicontact_control.experiment import run as run_module
from multicontact_control.experiment.bag import CUT_OFF, read_bag
from multicontact_control.experiment.closed_loop import run_in_process
from multicontact_control.experiment.graph.domain import domain_in_use, reserve_domain
from multicontact_control.experiment.graph.run import run_graph
from multicontact_control.experiment.graph.spec import (
    COMPOSED,
    CONTROLLER,
    ESTIMATOR,
    GraphSpec,
    node_command,
    RECORDER,
    SIM,
)
from multicontact_control.experiment.run import AUTO, GraphOptions, run_real_time
from multicontact_control.experiment.scenario import resolve
from multicontact_control.nodes.topics import (
    CLOCK,
    DIAGNOSTICS,
    EFFORT_COMMAND,
    NOISE_VARIANCE,
    STABILITY_MARGIN,
    STIFFNESS,
    TOPICS,
)
import numpy as np
import pytest
from rich.console import Console
from ros_graph import PATIENCE, wait_for
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_typestore, Stores

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[3]
TICKS = 1000
COMPOSED_NAMES = ('composed_node', 'composed_sim_node')
CONTROL_TOPICS = [f'/{topic.name}' for topic in TOPICS if topic.rate == 'control']
ADAPTIVE_TOPICS = [f'/{topic.name}' for topic in (STIFFNESS, STABILITY_MARGIN)]
STORE = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture
def free_domain(monkeypatch):
    """Let every run choose its own domain, whatever the environment says."""
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)


def make_spec(
        folder, *, plant='puma', ticks=TICKS, estimator='lead_window', preset='', **options):
    setup = resolve('quick', plant=plant, seed=options.get('seed', 0), duration=ticks / 500.0,
                    noise_estimator={'estimator': estimator}, preset=preset)
    config = folder / 'config'
    setup.write(config)
    files = {
        CONTROLLER: config / 'controller.yaml', SIM: config / 'plant.yaml',
        ESTIMATOR: config / 'noise_estimator.yaml'}
    return setup, GraphSpec(
        out=folder, parameter_files=files, ticks=ticks, rate=setup.controller.rate,
        reference_file=config / 'reference.yaml', **options)


def read_messages(bag, topic):
    """Return the messages of one topic of a bag."""
    with Reader(bag) as reader:
        name = f'/{topic.name.lstrip("/")}'
        connections = [x for x in reader.connections if x.topic == name]
        for connection, _, data in reader.messages(connections):
            yield STORE.deserialize_cdr(data, connection.msgtype)


def read(bag, topic):
    """Return (stamp [ns], message) of one topic of a bag."""
    for message in read_messages(bag, topic):
        stamp = message.header.stamp
        yield stamp.sec * 1_000_000_000 + stamp.nanosec, message


def counts(bag):
    with Reader(bag) as reader:
        return {x.topic: x.msgcount for x in reader.connections if x.topic in CONTROL_TOPICS}


@pytest.mark.slow
@pytest.mark.parametrize(
    ('plant', 'seed', 'estimator', 'supervised', 'composed', 'batches', 'preset'), [
        ('puma', 0, 'lead_window', True, 'none', False, 'best'),
        ('rigid', 1, 'lead_window', True, 'none', True, 'adaptive'),
        ('puma', 2, 'sage_husa', False, 'control', True, 'paper'),
        ('rigid', 3, 'innovation', False, 'control', False, 'laws/dob'),
        ('puma', 4, 'lead_window', True, 'all', True, 'paper'),
        ('rigid', 5, 'innovation', True, 'all', False, 'best')])
def test_run_graph_in_lockstep_is_the_run_in_process_bit_for_bit(
        tmp_path, free_domain, plant, seed, estimator, supervised, composed, batches, preset):
    setup, spec = make_spec(
        tmp_path, plant=plant, seed=seed, estimator=estimator, preset=preset, lockstep=True,
        composed=composed, recording_batches=batches,
        extra_parameters={CONTROLLER: {'supervised': supervised}})
    result = run_graph(spec)
    assert result.interrupted is None
    nothing = {} if preset == 'adaptive' else dict.fromkeys(ADAPTIVE_TOPICS, 0)
    assert counts(result.bag) == dict.fromkeys(CONTROL_TOPICS, TICKS) | nothing
    run = run_in_process(setup, supervised=supervised)
    expected = run.data
    events = [(pytest.approx(time), what) for time, what in run.events]
    assert [tuple(event) for event in result.timing[CONTROLLER]['events']] == events
    torque = np.array([message.effort for _, message in read(result.bag, EFFORT_COMMAND)])
    variance = np.array([message.effort for _, message in read(result.bag, NOISE_VARIANCE)])
    assert torque.tobytes() == expected.torque.tobytes()
    assert variance.tobytes() == expected.noise_variance.tobytes()
    for series, field in (('stiffness_est', 'position'), ('stiffness', 'effort')):
        found = np.array([getattr(message, field) for _, message in read(result.bag, STIFFNESS)])
        if found.size:
            assert found.tobytes() == getattr(expected, series).tobytes()
    clock = [(m.clock.sec, m.clock.nanosec) for m in read_messages(result.bag, CLOCK)]
    stamps = [(m.header.stamp.sec, m.header.stamp.nanosec)
              for _, m in read(result.bag, EFFORT_COMMAND)]
    assert clock == stamps


def test_run_graph_in_real_time_records_every_sample_at_its_rate(tmp_path, free_domain):
    _, spec = make_spec(tmp_path)
    seen = []
    result = run_graph(spec, seen.append)
    assert result.timing[RECORDER]['lost'] == 0
    assert result.timing[SIM]['ticks'] == TICKS
    stamps = np.array([stamp for stamp, _ in read(result.bag, TOPICS[0])])
    np.testing.assert_array_equal(np.diff(np.unique(stamps)), 2_000_000)
    assert np.unique(stamps).size == TICKS
    recorded = counts(result.bag)
    # What a busy machine may skip are answers, not samples.
    assert all(recorded[f'/{topic.name}'] >= TICKS for topic in TOPICS
               if topic.publisher == SIM and topic.rate == 'control')
    reporters = {status.name.split(':')[0] for message in read_messages(result.bag, DIAGNOSTICS)
                 for status in message.status}
    assert reporters == {CONTROLLER, ESTIMATOR, RECORDER, SIM}
    assert seen
    assert {'table', 'board'} == set(seen[-1].forces)
    assert [x.time for x in seen] == sorted(x.time for x in seen)


@pytest.mark.parametrize(('composed', 'process'), [
    *(('none', name) for name in (CONTROLLER, ESTIMATOR, RECORDER, SIM)),
    *zip(('control', 'all'), COMPOSED_NAMES)])
def test_run_graph_names_the_process_that_was_killed(tmp_path, free_domain, composed, process):
    _, spec = make_spec(tmp_path, ticks=50_000, composed=composed)
    killed = []

    def kill_it(_progress):
        if not killed:
            killed.append(kill_node(tmp_path, process))

    with pytest.raises(
            RunError, match=f'^{process} was killed by SIGKILL; the end of .*{process}.log'):
        run_graph(spec, kill_it)
    assert killed
    assert node_processes(tmp_path) == {}
    if process != RECORDER:
        assert counts(spec.bag)[CONTROL_TOPICS[0]] > 0


def node_processes(folder):
    """Return the processes whose command line speaks of a folder, by node name."""
    found = {}
    for entry in Path('/proc').iterdir():
        try:
            command = (entry / 'cmdline').read_bytes().decode().rstrip('\0').split()
        except (OSError, UnicodeDecodeError):
            continue
        for name in (RECORDER, ESTIMATOR, CONTROLLER, SIM, *COMPOSED_NAMES):
            if any(part.endswith((f'{folder}/logs/{name}.json"', f'{folder}/logs/{name}.yaml'))
                   for part in command):
                found[name] = int(entry.name)
    return found


def kill_node(folder, name):
    number = node_processes(folder)[name]
    os.kill(number, signal.SIGKILL)
    return number


def test_run_graph_shows_the_log_of_a_node_that_cannot_start(tmp_path, free_domain):
    _, spec = make_spec(tmp_path)
    path = spec.parameter_files[CONTROLLER]
    path.write_text(
        path.read_text(encoding='utf-8').replace('joint6', 'joint7'), encoding='utf-8')
    with pytest.raises(RunError, match='controller_node cannot configure') as caught:
        run_graph(spec)
    assert 'joint7' in str(caught.value)
    assert node_processes(tmp_path) == {}


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_run_graph_that_is_interrupted_closes_the_bag(tmp_path, free_domain, number):
    _, spec = make_spec(tmp_path, ticks=50_000)
    sent = []

    def interrupt(progress):
        if not sent:
            sent.append(progress)
            os.kill(os.getpid(), number)

    result = run_graph(spec, interrupt)
    assert result.interrupted == number
    recorded = counts(result.bag)
    # Commands go on a while without samples: the simulator is stopped first.
    assert recorded['/joint_states'] >= recorded['/contact_forces/measured'] > 0
    assert node_processes(tmp_path) == {}


class Impatient(io.StringIO):
    """Interrupts as soon as the graph has a domain, which is before anything runs."""

    def write(self, text):
        if 'ROS_DOMAIN_ID' in text:
            os.kill(os.getpid(), signal.SIGINT)
        return super().write(text)


def test_run_that_is_interrupted_before_the_first_sample_says_so(tmp_path, free_domain):
    text = Impatient()
    assert run_real_time(
        resolve('quick', plant='rigid', seed=0), tmp_path, GraphOptions(lockstep=True),
        console=Console(file=text, width=200)) == (None, signal.SIGINT)
    assert 'ended before any sample was answered: there is nothing to report' in text.getvalue()
    assert not (tmp_path / 'summary.json').exists() and node_processes(tmp_path) == {}


def test_run_graph_names_a_node_that_fails_while_it_is_stopped(tmp_path, free_domain):
    _, spec = make_spec(tmp_path, ticks=50_000)
    killing = []

    def kill_recorder():
        wait_for(lambda: CONTROLLER not in node_processes(tmp_path), 'the end of the controller')
        kill_node(tmp_path, RECORDER)

    def interrupt(_progress):
        if not killing:
            killing.append(threading.Thread(target=kill_recorder))
            killing[0].start()
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(RunError, match=f'^{RECORDER} was killed by SIGKILL; the end of .*log'):
        run_graph(spec, interrupt)
    killing[0].join()


def test_nodes_end_when_the_process_that_started_them_is_killed(tmp_path, free_domain):
    make_spec(tmp_path, ticks=50_000)
    program = (
        'import sys; from pathlib import Path\n'
        'from multicontact_control.experiment.graph.run import GraphSpec, run_graph\n'
        'f = Path(sys.argv[1]); c = f / "config"\n'
        'run_graph(GraphSpec(out=f, ticks=50000, rate=500.0, reference_file=c/"reference.yaml",\n'
        '  parameter_files={"controller_node": c/"controller.yaml", "sim_node": c/"plant.yaml",\n'
        '  "noise_estimator_node": c/"noise_estimator.yaml"}))\n')
    environment = {**os.environ, 'PYTHONPATH': str(ROOT)}
    parent = subprocess.Popen([sys.executable, '-c', program, str(tmp_path)], env=environment)
    wait_for(lambda: len(node_processes(tmp_path)) == 4, 'nodes started')
    parent.kill()
    parent.wait()
    wait_for(lambda: not node_processes(tmp_path), 'nodes ended')
    assert node_processes(tmp_path) == {}


def test_node_command_passes_numbers_as_what_they_are(tmp_path):
    _, spec = make_spec(tmp_path)
    command = node_command(SIM, spec)
    assert 'rate:=500.0' in command
    assert f'ticks:={TICKS}' in command
    assert 'lockstep:=false' in command


def test_reserve_domain_gives_two_runs_two_domains(free_domain):
    with reserve_domain() as first, reserve_domain() as second:
        assert first != second
    assert not domain_in_use(first)


@pytest.mark.parametrize('participant', [0, 7])
def test_domain_is_in_use_while_any_participant_is_there(free_domain, participant):
    with reserve_domain() as domain_id, socket.socket(
            socket.AF_INET, socket.SOCK_DGRAM) as listener:
        assert not domain_in_use(domain_id)
        listener.bind(('', 7400 + 250 * domain_id + 10 + 2 * participant))
        assert domain_in_use(domain_id)
    assert not domain_in_use(domain_id)


def test_reserve_domain_obeys_the_environment(monkeypatch):
    monkeypatch.setenv('ROS_DOMAIN_ID', '37')
    with reserve_domain() as domain_id:
        assert domain_id == 37


def test_run_graph_works_in_a_thread_without_signals(tmp_path, free_domain):
    _, spec = make_spec(tmp_path, ticks=50)
    results = []
    thread = threading.Thread(target=lambda: results.append(run_graph(spec)))
    thread.start()
    thread.join(PATIENCE)
    assert results


def test_command_line_knows_every_composition():
    assert {choice.value for choice in Composed} == {AUTO, *COMPOSED}


def test_run_says_what_its_recording_and_its_recorder_lack(tmp_path, free_domain, monkeypatch):
    def read_cut_off(path, *options, **more):
        file, = path.glob('*.mcap')
        os.truncate(file, file.stat().st_size - 1000)
        return read_bag(path, *options, **more)

    monkeypatch.setattr(run_module, 'read_bag', read_cut_off)
    setup = resolve('quick', plant='rigid', seed=0, duration=0.5)
    summary, _ = run_real_time(
        setup, tmp_path, GraphOptions(lockstep=True), console=Console(file=io.StringIO()))
    assert summary['remarks'] == [CUT_OFF]
    assert summary['timing']['lost_messages'] >= 0
    timing = run_module.graph_timing({}, read_bag(tmp_path / 'bag', setup.controller))
    assert timing['lost_messages'] is None


def test_run_says_in_which_domain_it_is(tmp_path, free_domain):
    setup = resolve('quick', plant='rigid', seed=0, duration=0.5)
    text = io.StringIO()
    summary, interrupted = run_real_time(
        setup, tmp_path, GraphOptions(lockstep=True), console=Console(file=text, width=200))
    domain_id = summary['ros_domain_id']
    assert interrupted is None
    assert 0 <= domain_id <= 101
    assert f'ROS_DOMAIN_ID={domain_id} multicontact topic list' in text.getvalue()
    written = json.loads((tmp_path / 'summary.json').read_text(encoding='utf-8'))
    assert written['ros_domain_id'] == domain_id
