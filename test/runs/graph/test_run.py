"""The real graph: processes, middleware, bag; run to its end, commanded, and with a death."""

from contextlib import suppress
import json
import os
import signal
import socket
import subprocess

from canonical_runs import run_of
from multicontact_control.client import CommandRefusedError, MultiContactClient
from multicontact_control.errors import RunError
from multicontact_control.judging.claims import judge_claims_of_run
from multicontact_control.judging.results import load_run
from multicontact_control.nodes import topics
from multicontact_control.nodes.topics import (
    CONTROLLER,
    ESTIMATOR,
    RECORDER,
    SIM,
    TOPICS,
)
from multicontact_control.runs.graph import domain
from multicontact_control.runs.graph.processes import NodeProcesses
from multicontact_control.runs.graph.run import run_graph
from multicontact_control.runs.graph.spec import GraphSpec
from multicontact_control.runs.scenario import resolve
import numpy as np
from numpy.testing import assert_array_equal
import pytest
from ros_graph import end_of, node_processes, PATIENCE, recorded, start_command
from rosbags.rosbag2 import Reader

pytestmark = pytest.mark.ros

TICKS = 1000
ENDLESS = 50_000
CONTROL_TOPICS = [
    f'/{topic.name.lstrip("/")}' for topic in TOPICS if topic.rate == 'control'
]
ADAPTIVE_TOPICS = (f'/{topics.STIFFNESS.name}', f'/{topics.STABILITY_MARGIN.name}')


def make_spec(
    folder,
    *,
    plant='rigid',
    ticks=TICKS,
    seed=0,
    estimator='lead_window',
    preset='',
    **options,
):
    setup = resolve(
        'quick',
        plant=plant,
        seed=seed,
        duration=ticks / 500.0,
        noise_estimator={'estimator': estimator},
        preset=preset,
    )
    config = folder / 'config'
    spec = GraphSpec(
        out=folder,
        parameter_files=setup.write(config),
        ticks=ticks,
        rate=500.0,
        seed=seed,
        reference_file=config / 'reference.yaml',
        **options,
    )
    return setup, spec


def samples(bag, topic):
    """Return one message for each stamp: in lockstep, a sample that waits long is sent again."""
    by_stamp = {}
    for message in recorded(bag, topic):
        stamp = message.header.stamp if hasattr(message, 'header') else message.clock
        by_stamp[stamp.sec, stamp.nanosec] = message
    return list(by_stamp.values())


def counts(bag):
    return {topic: len(samples(bag, topic)) for topic in CONTROL_TOPICS}


def series(bag, topic, field='effort'):
    """Return the numbers of a topic, a row for each sample."""
    return np.array([getattr(message, field) for message in samples(bag, topic.name)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ('plant', 'seed', 'estimator', 'supervised', 'preset', 'speed'),
    [
        ('puma', 0, 'lead_window', True, 'best', 1.0),
        ('rigid', 1, 'lead_window', True, 'adaptive', 0.0),
        ('rigid', 3, 'innovation', False, 'laws/dob', 0.0),
    ],
)
def test_graph_is_the_run_in_process_bit_for_bit(
    tmp_path, plant, seed, estimator, supervised, preset, speed
):
    setup, spec = make_spec(
        tmp_path,
        plant=plant,
        seed=seed,
        estimator=estimator,
        preset=preset,
        speed=speed,
        extra_parameters={CONTROLLER: {'supervised': supervised}},
    )
    result = run_graph(spec)
    expected = dict.fromkeys(CONTROL_TOPICS, TICKS)
    if preset != 'adaptive':
        expected |= dict.fromkeys(ADAPTIVE_TOPICS, 0)
    bag = result.bag
    assert counts(bag) == expected
    run = run_of(setup, supervised=supervised)
    events = [(pytest.approx(time), what) for time, what in run.events]
    assert [tuple(event) for event in result.timing[CONTROLLER]['events']] == events
    commands = series(bag, topics.EFFORT_COMMAND)
    assert commands.tobytes() == run.data.torque.tobytes()
    variances = series(bag, topics.NOISE_VARIANCE)
    assert variances.tobytes() == run.data.noise_variance.tobytes()
    if preset == 'adaptive':
        used = series(bag, topics.STIFFNESS)
        estimated = series(bag, topics.STIFFNESS, 'position')
        assert used.tobytes() == run.data.stiffness.tobytes()
        assert estimated.tobytes() == run.data.stiffness_est.tobytes()
    answered = [x.header.stamp for x in samples(bag, topics.EFFORT_COMMAND.name)]
    assert [x.clock for x in samples(bag, topics.CLOCK.name)] == answered
    sim = result.timing[SIM]
    assert sim['ticks'] == TICKS
    assert result.timing[RECORDER]['lost'] == 0
    assert sum(sim['latency_histogram']['counts']) == TICKS - 1
    assert sim['deadline_misses'] == 0
    if speed:  # never ahead of the wall clock
        assert sim['wall_s'] > 0.94 * TICKS / 500.0 / speed


def test_free_run_records_every_sample_at_its_rate(tmp_path):
    _, spec = make_spec(
        tmp_path,
        ticks=3 * TICKS,
        free_running=True,
        extra_parameters={CONTROLLER: {'effort_output_topic': 'bare/efforts'}},
    )
    seen = []
    result = run_graph(spec, seen.append)
    assert result.timing[SIM]['ticks'] == 3 * TICKS
    stamps = [message.header.stamp for message in recorded(result.bag, TOPICS[0].name)]
    steps = np.diff([stamp.sec * 10**9 + stamp.nanosec for stamp in stamps])
    assert_array_equal(steps[steps > 0], 2_000_000)
    efforts = {tuple(x.data) for x in recorded(result.bag, 'bare/efforts')}
    commands = recorded(result.bag, topics.EFFORT_COMMAND.name)
    assert efforts
    assert efforts <= {tuple(x.effort) for x in commands}
    reporters = set()
    for report in recorded(result.bag, topics.DIAGNOSTICS.name):
        reporters.update(status.name.split(':')[0] for status in report.status)
    assert reporters == {CONTROLLER, ESTIMATOR, RECORDER, SIM}
    assert seen[-1].forces.keys() == {'table', 'board'}
    times = [progress.time for progress in seen]
    assert times == sorted(times)


@pytest.mark.parametrize('name', [CONTROLLER, ESTIMATOR, RECORDER, SIM])
def test_node_that_is_killed_ends_the_run_and_is_named(tmp_path, name):
    _, spec = make_spec(tmp_path, ticks=ENDLESS)

    def kill(progress):
        with suppress(KeyError):  # it is killed already
            os.kill(node_processes(tmp_path)[name], signal.SIGKILL)

    with pytest.raises(
        RunError, match=f'^{name} was killed by SIGKILL; the end of .*{name}.log'
    ):
        run_graph(spec, kill)
    assert node_processes(tmp_path) == {}
    if name != RECORDER:
        assert counts(spec.bag)[CONTROL_TOPICS[0]] > 0


def test_node_that_cannot_start_ends_the_run_with_its_log(tmp_path):
    _, spec = make_spec(tmp_path)
    path = spec.parameter_files[CONTROLLER]
    path.write_text(path.read_text(encoding='utf-8').replace('joint6', 'joint7'))
    with pytest.raises(RunError, match='controller_node cannot configure(.|\n)*joint7'):
        run_graph(spec)
    assert node_processes(tmp_path) == {}


@pytest.mark.slow
def test_second_interrupt_skips_the_report_and_says_how_to_write_it(tmp_path):
    process = start_command(
        'run', '--plant', 'rigid', '--out', tmp_path / 'run', cwd=tmp_path, stderr=None
    )
    for text in ('ready; ', 'stopping the nodes'):
        assert any(text in line for line in process.stdout)
        process.send_signal(signal.SIGINT)
    text, _ = end_of(process)
    assert process.returncode == 130
    assert f'multicontact report {tmp_path / "run"}' in text
    assert any(counts(tmp_path / 'run/bag').values())
    assert not (tmp_path / 'run/summary.json').exists()


def test_warnings_of_nodes_are_given_once_each(tmp_path):
    processes = NodeProcesses(GraphSpec(tmp_path, {}, ticks=1, rate=500.0), 0)
    processes.running = {CONTROLLER: None}
    log = tmp_path / f'logs/{CONTROLLER}.log'
    for text, warning in (
        ('[INFO] [1.5] [node]: fine\n', ''),
        ('[WARN] [1.5] [node]: h', ''),
        ('[WARN] [1.5] [node]: hot\n', 'WARN: node: hot'),
    ):
        log.write_text(text)
        assert processes.new_warnings() == warning
        assert processes.new_warnings() == ''


@pytest.mark.slow
def test_commanded_arm_obeys_until_a_signal_and_is_judged_by_what_was_commanded(
    tmp_path,
):
    out = tmp_path / 'run'
    with domain.reserve_domain() as domain_id:
        process = start_command(
            *('run', '--commanded', '--speed', '0'),
            *('--scenario', 'quick', '--plant', 'rigid'),
            *('--domain-id', domain_id, '--out', out),
            cwd=tmp_path,
            stderr=subprocess.STDOUT,
        )
        try:
            with MultiContactClient(domain_id=domain_id, timeout=PATIENCE) as arm:
                arm.set_forces({'table': 10.0, 'board': 5.0})
                state = arm.wait_until_reached(timeout=PATIENCE)
                arm.move(state.position_world + [0.02, 0.0, 0.0], duration=1.0)
                moved = arm.wait_until_reached(timeout=PATIENCE)
                with pytest.raises(CommandRefusedError):
                    arm.set_forces({'table': 5000.0})
                _, second = make_spec(tmp_path / 'second', domain_id=domain_id)
                in_use = f'^ROS domain {domain_id}: expected no '
                with pytest.raises(RunError, match=in_use):
                    run_graph(second)
                end = arm.read()
                while end.time < moved.time + 1.5:  # rest begins after 1 s
                    end = arm.read()
        finally:
            process.send_signal(signal.SIGINT)
            text, _ = end_of(process)
    assert process.returncode == 0, text
    assert 'stable' in text
    assert f'topic echo /contact_forces/measured --domain-id {domain_id}' in text
    assert node_processes(out) == {}
    summary = json.loads((out / 'summary.json').read_text(encoding='utf-8'))
    assert summary['verdict'] == 'stable'
    assert summary['commanded_by_topic'] is True
    assert summary['scenario'] == 'commands'
    assert summary['ticks'] / summary['rate_hz'] > end.time - state.time
    assert summary['contacts']['table']['rest']['true_error_rms_n'] < 0.1
    run = load_run(out)
    # No scenario was played.
    assert summary['claims'] == judge_claims_of_run(run.metrics, run.summary) == []
    assert run.data.command[-1].tolist() == [10.0, 5.0]
    assert run.setup.scenario.duration == pytest.approx(run.data.ticks / run.data.rate)


@pytest.mark.nightly
def test_two_graphs_in_one_domain_record_their_own_topics_only(tmp_path):
    bags = {side: tmp_path / side / 'bag' for side in ('left', 'arms/right')}
    duration = TICKS / 500.0
    with domain.reserve_domain() as domain_id:
        runs = []
        for seed, (side, bag) in enumerate(bags.items()):
            run = start_command(
                *('run', '--scenario', 'quick', '--plant', 'rigid'),
                *('--duration', duration, '--seed', seed, '--out', bag.parent),
                *('--namespace', side, '--domain-id', domain_id),
                cwd=tmp_path,
            )
            runs.append(run)
        for run in runs:
            _, errors = end_of(run)
            assert run.returncode == 0, errors
    last_forces = set()
    for side, bag in bags.items():
        with Reader(bag) as reader:
            names = {connection.topic for connection in reader.connections}
        names.remove('/clock')
        for name in names:
            assert name.startswith(f'/{side}/')
        for topic in (topics.JOINT_STATES, topics.EFFORT_COMMAND):
            assert len(samples(bag, f'/{side}/{topic.name}')) == TICKS
        wrenches = recorded(bag, f'/{side}/ft_sensor/wrench')
        last_forces.add(wrenches[-1].wrench.force.z)
    assert len(last_forces) == 2  # the seeds differ, and so do the graphs


@pytest.mark.parametrize('participant', [0, 7])
def test_domain_is_reserved_once_and_in_use_while_any_participant_is_there(participant):
    with domain.reserve_domain() as first, domain.reserve_domain() as domain_id:
        assert first != domain_id
        assert not domain.domain_in_use(domain_id)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
            listener.bind(('', 7400 + 250 * domain_id + 10 + 2 * participant))
            assert domain.domain_in_use(domain_id)
        assert not domain.domain_in_use(domain_id)
