"""The fault campaign over the graph: what it does to messages, how it judges, and one in short."""

from __future__ import annotations

from collections import deque
import math
import os
import signal
import threading
from types import SimpleNamespace

from multicontact_control.experiment.faults import graph_session, in_graph, vocabulary
from multicontact_control.experiment.faults.fault import Delivery, Edit, GRAPH, NodeChange, PROCESS
from multicontact_control.experiment.faults.graph_relay import (
    Distortion,
    INPUTS,
    read_field,
    stream_faults,
)
from multicontact_control.experiment.faults.graph_watch import (
    busy_share,
    GraphWatch,
    observe,
    ReceivedMessage,
    Report,
    Window,
)
from multicontact_control.experiment.faults.in_graph import BUSY, graph_tasks, GraphCampaign
from multicontact_control.experiment.faults.in_process import Corruptor
from multicontact_control.experiment.faults.judge import judge
from multicontact_control.experiment.faults.vocabulary import faults_of, general_kind, quick_faults
from multicontact_control.experiment.graph.spec import (
    CONTROLLER,
    ESTIMATOR,
    RECORDER,
    SIM,
    START_ORDER,
)
from multicontact_control.experiment.scenario import resolve
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.link import GOALS, GuestNode
from multicontact_control.supervision.inputs import (
    JointInput,
    TickInputs,
    VarianceInput,
    WrenchInput,
)
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from ros_graph import wait_for

pytestmark = pytest.mark.ros

JOINTS = [f'joint{i}' for i in range(1, 7)]
FAULTS = faults_of(GRAPH)
WANTED = {'table': 10.0, 'board': 10.0}


@pytest.fixture(autouse=True)
def own_domain(monkeypatch):
    """Let every campaign choose its own domain, whatever the environment says."""
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')


def message_of(source, k):
    stamp = (k + 1000) * 2_000_000
    if source == 'wrench':
        return messages.wrench_message(stamp, np.arange(1.0, 7.0) + k, 'ft_face')
    if source == 'variance':
        return messages.joint_state_message(stamp, list(WANTED), effort=[1.0 + k, 2.0 + k])
    return messages.joint_state_message(
        stamp, JOINTS, position=np.arange(6.0) + k, velocity=np.arange(6.0) - k)


def passed_on(source, kind, count=60, seed=3):
    """Return what becomes of `count` messages after 40 good ones, and those messages."""
    stream = 'joints' if source == 'clock' else source
    history = deque(maxlen=512)
    distortion = None
    sent, out = [], []
    for k in range(40 + count):
        data = serialize_message(message_of(stream, k))
        history.append(data)
        if k < 40:
            continue
        distortion = distortion or Distortion(
            FAULTS[kind, source], np.random.default_rng(seed), INPUTS[stream].message, history,
            (40 + 1000) * 2_000_000)
        sent.append(data)
        out.append([deserialize_message(x, INPUTS[stream].message)
                    for x in distortion.passed_on(data)])
    return [deserialize_message(x, INPUTS[stream].message) for x in sent], out


def stamps(found):
    return [messages.stamp_to_ns(x.header.stamp) // 2_000_000 - 1000 for x in found]


def flat(out):
    return [x for several in out for x in several]


@pytest.mark.parametrize(('source', 'kind'), [
    (source, kind) for kind, source in stream_faults()])
def test_graph_faults_change_every_stream(source, kind):
    sent, out = passed_on(source, kind)
    assert out != [[x] for x in sent]


def test_graph_faults_of_delivery_deliver_as_they_say():
    now = list(range(40, 100))
    delivered = {kind: [stamps(x) for x in passed_on('wrench', kind)[1]]
                 for (kind, source), fault in FAULTS.items()
                 if source == 'wrench' and isinstance(fault.action, Delivery)}
    assert delivered['dropped'] == [[] for _ in now]
    assert delivered['delayed'] == [[k - 10] for k in now]
    assert delivered['stuck'] == [[39] for _ in now]
    assert delivered['duplicated'] == [[k, k] for k in now]
    assert delivered['reordered'] == [[] if k % 2 == 0 else [k, k - 1] for k in now]
    assert delivered['out_of_order'] == [[k, k - 25] for k in now]
    assert [x for x in delivered['burst'] if x] == [
        list(range(k, k + 10)) for k in range(40, 100, 10)]
    assert 5 < sum(not x for x in delivered['intermittent']) < 35


def test_graph_faults_of_values_leave_the_stamps_and_those_of_stamps_the_values():
    sent, out = passed_on('wrench', 'sign_flipped')
    assert stamps(flat(out)) == stamps(sent)
    assert [x.wrench.force.y for x in flat(out)] == [-x.wrench.force.y for x in sent]
    _, out = passed_on('joints', 'frozen')
    assert len({tuple(x.position) for x in flat(out)}) == 1
    assert stamps(flat(out)) == list(range(40, 100))
    _, out = passed_on('variance', 'nan')
    assert all(sum(map(math.isnan, x.effort)) == 1 for x in flat(out))
    sent, out = passed_on('clock', 'backwards')
    assert stamps(flat(out)) == [k - 25 for k in stamps(sent)]
    assert [x.position for x in flat(out)] == [x.position for x in sent]


@pytest.mark.parametrize('fault', [
    fault for fault in FAULTS.values()
    if PROCESS in fault.where and isinstance(fault.action, Edit)],
    ids=lambda fault: f'{fault.input}-{fault.kind}')
def test_graph_faults_of_values_are_those_in_process(fault):
    """The same change, of a message on its way and of a reading of a tick."""
    def reading(k):
        message = message_of(fault.input, k)
        if fault.input == 'wrench':
            return WrenchInput(0.0, np.arange(1.0, 7.0) + k)
        if fault.input == 'variance':
            return VarianceInput(0.0, np.array(message.effort))
        return JointInput(0.0, np.array(message.position), np.array(message.velocity))

    def tick(k):
        return TickInputs(0.0)._replace(**{fault.input: reading(k)})
    loop = SimpleNamespace(
        inputs=lambda: tick(40), history=[],
        setup=SimpleNamespace(controller=SimpleNamespace(
            robot=SimpleNamespace(joint_names=JOINTS))))
    corruptor = Corruptor(fault, np.random.default_rng(3), loop)
    for k, (message,) in enumerate(passed_on(fault.input, fault.kind, 5)[1], 40):
        found = getattr(corruptor.corrupt(tick(k)), fault.input)
        for name in fault.action.fields:
            np.testing.assert_array_equal(getattr(found, name), read_field(message, name))


def test_graph_faults_have_every_kind_in_short_and_each_once_per_seed():
    assert len(FAULTS) == sum(GRAPH in fault.where for fault in vocabulary.FAULTS) >= 80
    quick = quick_faults(GRAPH, 0)
    assert set(map(general_kind, FAULTS.values())) == set(map(general_kind, quick))
    assert len(quick) == len(set(map(general_kind, quick))) < 60
    assert {fault.input for seed in range(3) for fault in quick_faults(GRAPH, seed)} == {
        source for _, source in FAULTS}
    assert graph_tasks(('rigid',), 5) == graph_tasks(('rigid',), 5) != graph_tasks(('rigid',), 6)


def test_graph_faults_know_the_nodes_and_their_transitions():
    changes = [fault for fault in FAULTS.values() if isinstance(fault.action, NodeChange)]
    assert {fault.input for fault in changes} == set(START_ORDER)
    assert {step for fault in changes for step in fault.action.steps} <= {
        'kill', 'halt', *GOALS}


@pytest.fixture(scope='module')
def watch():
    guest = GuestNode('graph_faults_test', 101)
    yield GraphWatch(guest.node)
    guest.close()


def judged(watch, fault=('stuck', 'variance'), *, change=None, problems=(), recovered=2.0):
    """Return the row of two good seconds, changed."""
    said = {topic: [] for topic in watch.said}
    for k in range(1000):
        time = 100.0 + 0.002 * k
        said[topics.EFFORT_COMMAND].append(
            ReceivedMessage(time, {name: 1.0 + 1e-3 * k for name in JOINTS}))
        said[topics.TRUE_FORCES].append(ReceivedMessage(time, dict(WANTED)))
        said[topics.DESIRED_FORCES].append(ReceivedMessage(time, dict(WANTED)))
    reports = []
    if change is not None:
        change(said, reports)
    watch.reports = deque(reports)
    for topic, found in said.items():
        watch.said[topic] = deque(found)
    setup = resolve('quick', plant='rigid', seed=0)
    window = Window(100.0, 101.0, recovered if recovered < 0.0 else 100.0 + recovered)
    seen = observe(watch, setup, WANTED, window, problems)
    return judge(FAULTS[fault], 7, setup, seen, where=GRAPH)


def test_graph_faults_judge_finds_nothing_wrong_with_what_is_good(watch):
    row = judged(watch)
    assert (row.safe, row.problems, row.reaction, row.time_to_safe_s) == (True, '', 'none', 0.0)
    assert (row.where, row.plant, row.seed) == ('graph', 'rigid', 7)
    assert row.peak_force_n == 10.0
    assert row.peak_torque_fraction == round(1.999 / 20.1, 5)


def put(topic, value, places=slice(500, 501), name=None):
    def change(said, _reports):
        for x in said[topic][places]:
            x.values[name or next(iter(x.values))] = value
    return change


def remove(topic, places):
    def change(said, _reports):
        del said[topic][places]
    return change


@pytest.mark.parametrize(('change', 'problem'), [
    (put(topics.EFFORT_COMMAND, float('nan')), 'command not finite'),
    (put(topics.DESIRED_FORCES, float('inf')), 'contact_forces/desired not finite'),
    (put(topics.EFFORT_COMMAND, 21.0, name='joint5'), 'torque beyond its limit'),
    (put(topics.EFFORT_COMMAND, 12.0, name='joint5'), 'torque rate beyond its limit'),
    (put(topics.TRUE_FORCES, 80.0, slice(500, 560)), 'force beyond the ceiling for too long'),
    (put(topics.DESIRED_FORCES, 30.0), 'obeyed a command it should have refused'),
    (remove(topics.EFFORT_COMMAND, slice(300, 700)), 'commands stopped'),
    (remove(topics.EFFORT_COMMAND, slice(300, None)), 'commands stopped')])
def test_graph_faults_judge_finds_what_is_wrong(watch, change, problem):
    row = judged(watch, change=change)
    assert not row.safe
    assert problem in row.problems.split(', ')


def test_graph_faults_judge_allows_what_is_declared(watch):
    silent = remove(topics.EFFORT_COMMAND, slice(300, 700))
    row = judged(watch, ('killed', CONTROLLER), change=silent)
    assert (row.safe, row.reaction, row.time_to_safe_s) == (True, 'silent', 1.4)

    def greeted(said, reports):  # the successor, until it had all its inputs
        silent(said, reports)
        reports.append(Report(101.5, CONTROLLER, {'ticks with float': '30'}))
    assert judged(watch, ('killed', CONTROLLER), change=greeted).reaction == 'silent'
    short = judged(watch, change=put(topics.TRUE_FORCES, 80.0, slice(500, 520)))
    assert (short.safe, short.time_to_safe_s) == (True, 1.038)

    def stalled(said, reports):  # no samples, no answers
        remove(topics.EFFORT_COMMAND, slice(300, 700))(said, reports)
        remove(topics.TRUE_FORCES, slice(300, 700))(said, reports)
    assert judged(watch, change=stalled).safe
    assert judged(watch, problems=['recorder_node died']).problems == 'recorder_node died'
    assert judged(watch, recovered=-1.0, problems=['x']).time_to_safe_s == -1.0


def test_graph_faults_judge_takes_the_reaction_from_diagnostics_if_they_tell(watch):
    paused = put(topics.DESIRED_FORCES, 0.0, slice(100, 120), 'table')
    assert judged(watch, change=paused).reaction == 'none'

    def both(said, reports):
        paused(said, reports)
        put(topics.DESIRED_FORCES, 0.0, slice(100, 120), 'board')(said, reports)
    assert judged(watch, change=both).reaction == 'paused'

    def told(said, reports):
        both(said, reports)
        for at, counts in ((99.5, {'damp': 9}), (100.5, {'damp': 9, 'hold': 3}),
                           (101.2, {'damp': 9, 'hold': 3, 'inflate': 2}),
                           (102.2, {'damp': 10, 'hold': 3, 'inflate': 2})):
            reports.append(Report(at, CONTROLLER, {
                f'ticks with {name}': str(n) for name, n in counts.items()}))
    assert judged(watch, change=told).reaction == 'hold'


def test_graph_faults_know_a_machine_that_is_too_busy():
    def told(node, latency):
        return Report(1.0, node, {'latency_us_p50': latency})
    assert busy_share([], 0.002) == 0.0
    reports = [told(SIM, '999'), told(SIM, '1001'), told(SIM, 'none'), told(CONTROLLER, '5000'),
               told(SIM, '300'), told(SIM, '200')]
    assert busy_share(reports, 0.002) == 0.25


def problems_of(campaign, tmp_path, attempts=4):
    """
    Return what went wrong, with faults that did what a busy machine does put in again.

    It leaves the controller nothing for a third of a second, and, if it tells that it was too
    busy, never enough for contact, or commands that come 10 to 30 ms apart, with which contacts
    bounce; but now and then, and a fault that does, does so every time.
    """
    causes = ('commands stopped', *(
        ('back in contact', 'force beyond the ceiling') if campaign.busy > BUSY else ()))
    # Nor does a graph get into contact on such a machine: it was started again.
    unsafe = [x for x in campaign.rows if not x.safe and not (
        x.kind == 'started' and 'back in contact' in causes and x.problems.startswith(causes))]
    again = [x for x in unsafe if (x.kind, x.input) in FAULTS and all(
        problem.startswith(causes) for problem in x.problems.split(', '))]
    found = [(x.kind, x.input, x.problems) for x in unsafe if x not in again or not attempts]
    if not again or not attempts:
        return found
    anew = GraphCampaign({'rigid': [(FAULTS[x.kind, x.input], 0) for x in again]}, 0,
                         tmp_path / f'again{attempts}')
    anew.run()
    return found + problems_of(anew, tmp_path, attempts - 1)


def test_graph_faults_are_survived_by_a_real_graph(tmp_path):
    chosen = [('killed', ESTIMATOR), ('killed', CONTROLLER), ('killed', RECORDER),
              ('halted', CONTROLLER), ('nan', 'variance'), ('duplicated', 'joints'),
              ('nan', 'forces command'), ('unknown_contact', 'forces command'),
              ('ends_at_speed', 'motion command'), ('ends_too_fast', 'motion command')]
    done = []
    campaign = GraphCampaign(
        {'rigid': [(FAULTS[key], 0) for key in chosen]}, 0, tmp_path,
        on_progress=lambda *numbers: done.append(numbers))
    rows = campaign.run()
    assert problems_of(campaign, tmp_path) == []
    assert {(row.kind, row.input) for row in rows} == {*chosen, ('ended', 'graph')}
    assert all(row.where == 'graph' for row in rows)
    assert done == [(n, len(rows)) for n in range(1, len(rows) + 1)]
    reactions = {(row.kind, row.input): row.reaction for row in rows}
    assert reactions['killed', CONTROLLER] == 'silent'
    # Its drives hold the arm meanwhile; how far forces rise until then is for `safe` to judge.
    peaks = {(row.kind, row.input): row.peak_force_n for row in rows}
    assert peaks['killed', CONTROLLER] > 5.0
    bags = [sorted(path.name for path in graph.glob('bag*'))
            for graph in sorted((tmp_path / 'graphs').iterdir())]
    assert ['bag', 'bag_1'] in bags
    assert all(found in (['bag'], ['bag', 'bag_1']) for found in bags)


def test_graph_faults_tell_of_a_graph_that_does_not_come_up(tmp_path, monkeypatch):
    monkeypatch.setattr(graph_session, 'RECOVERY_TIMEOUT', 0.0)
    campaign = GraphCampaign({'rigid': [(FAULTS['stuck', 'variance'], 0)]}, 0, tmp_path)
    rows = campaign.run()
    assert [(row.kind, row.input, row.safe) for row in rows] == [
        ('stuck', 'variance', False), *[('started', 'graph', False)] * 2]
    assert [row.problems for row in rows] == [
        'not run: no graph came up for it', *['back in contact: not within 0 s'] * 2]


def test_graph_faults_name_a_node_that_dies_before_the_fault(tmp_path, monkeypatch):
    monkeypatch.setattr(in_graph, 'QUIET', (1.0, 1.0))
    start, killed = graph_session.FaultSession.__enter__, []

    def fragile(session):
        start(session)
        if not killed:
            killed.append(session.processes.signal(RECORDER, signal.SIGKILL))
        return session

    monkeypatch.setattr(graph_session.FaultSession, '__enter__', fragile)
    campaign = GraphCampaign({'rigid': [(FAULTS['duplicated', 'joints'], 0)]}, 0, tmp_path)
    row = campaign.run()[0]
    assert (row.kind, row.input, row.safe) == ('duplicated', 'joints', False)
    assert row.problems == 'recorder_node died before the fault'


def test_graph_faults_end_at_once_and_cleanly_on_a_signal(tmp_path, monkeypatch):
    # A busy machine may never bring a graph into contact, and a first fault waits for that.
    monkeypatch.setattr(graph_session.FaultSession, '_in_contact', lambda session: True)
    campaign = GraphCampaign(
        {'rigid': [(FAULTS['stuck', 'variance'], seed) for seed in range(1000)]}, 0, tmp_path)

    def interrupt():
        try:
            wait_for(lambda: campaign.rows, 'a first fault')
        finally:
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt, daemon=True)
    thread.start()
    rows = campaign.run()
    thread.join()
    assert campaign.interrupted == signal.SIGINT
    assert 1 <= len(rows) < 1000
