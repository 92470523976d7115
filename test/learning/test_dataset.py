"""Datasets: every number is the recording's, read without this package's readers."""

import json
import os
import re
import subprocess
from types import SimpleNamespace

from canonical_runs import run_of, summary_of
import foreign_bag
from mcap.reader import make_reader
from multicontact_control.cli.application import app
from multicontact_control.files import replace_json_file
from multicontact_control.runs.scenario import resolve
from multicontact_control.supervision.contacts import HOLDING, STATE_NAMES
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from ros_graph import ROOT, start_command, wait_for
from rosbags.typesys import get_typestore, Stores
from test_versions import install, OF_THIS_VENV, registry, venv_python  # noqa: F401
from typer.testing import CliRunner

RATE = 500
CONTACTS = ('table', 'board')
SECONDS = 1.5
STATUS = 'controller_node/status'
IMAGE = 'wrist/image_raw'
TYPES = foreign_bag.TYPES | {
    'contact_forces/stiffness': foreign_bag.JOINT_STATE,
    IMAGE: 'sensor_msgs/msg/Image',
}
# Of each feature: the topics it is made of, and the numbers of their messages.
FORCE_FEATURES = {
    'force': 'contact_forces/measured',
    'force_estimated': 'contact_forces/estimated',
    'force_desired': 'contact_forces/desired',
    'force_variance': 'contact_forces/noise_variance',
}
FEATURES = {f'observation.{name}': (topic,) for name, topic in FORCE_FEATURES.items()}
FEATURES |= {
    'observation.environment_state': (
        'contact_forces/measured',
        'contact_forces/estimated',
        'contact_forces/noise_variance',
    ),
    'observation.wrench': ('ft_sensor/wrench',),
    'observation.stiffness': ('contact_forces/stiffness',),
    'action': ('operational_point/pose_desired', 'contact_forces/desired'),
}
WINDOWS = {f'window.{name}': topic for name, topic in FORCE_FEATURES.items()}
WINDOWS['window.wrench'] = 'ft_sensor/wrench'


def setup():
    return resolve('quick', plant='rigid', preset='adaptive')


def messages_of(data, stamps, contacts=CONTACTS):
    """Yield topic, time and message of the samples of a run that have these stamps, not 0."""

    def pose(stamp, position, quaternion):
        place = SimpleNamespace(
            position=foreign_bag.xyz(*position),
            orientation=foreign_bag.xyz(*quaternion),
        )
        return SimpleNamespace(header=foreign_bag.header(stamp), pose=place)

    state = foreign_bag.joint_state
    for k in np.flatnonzero(stamps):
        stamp = int(stamps[k])
        wrench = SimpleNamespace(
            force=foreign_bag.xyz(*data.wrench[k, :3]),
            torque=foreign_bag.xyz(*data.wrench[k, 3:]),
        )
        if k % 250 == 0:
            yield STATUS, stamp, status(stamp, k, contacts)
        joints = (data.q[k], data.qd[k], data.effort[k])
        yield 'joint_states', stamp, state(stamp, data.joint_names, *joints)
        header = foreign_bag.header(stamp)
        yield 'ft_sensor/wrench', stamp, SimpleNamespace(header=header, wrench=wrench)
        for topic, series in (
            ('contact_forces/measured', data.alpha_meas),
            ('contact_forces/estimated', data.alpha_est),
            ('contact_forces/desired', data.alpha_des),
            ('contact_forces/noise_variance', data.noise_variance),
            ('contact_forces/stiffness', data.stiffness),
        ):
            yield topic, stamp, state(stamp, contacts, effort=series[k])
        actual = pose(stamp, data.position[k], data.quaternion[k])
        yield 'operational_point/pose', stamp, actual
        desired = pose(stamp, data.position_des[k], data.quaternion_des[k])
        yield 'operational_point/pose_desired', stamp, desired


def status(stamp, tick, contacts):
    """Return a status in which the first contact is the next state after each half second."""
    words = f'{contacts[0]} {STATE_NAMES[tick // 250]}, {contacts[1]} given up'
    message = foreign_bag.status(stamp, 'state')
    message.values = [SimpleNamespace(key='contacts', value=words)]
    return message


def regular_stamps(data):
    return foreign_bag.START + np.rint(data.time * 1e9).astype(np.int64)


@pytest.fixture(scope='module')
def data():
    return run_of(setup()).data.part(0, round(SECONDS * RATE))


@pytest.fixture(scope='module')
def bag(data, tmp_path_factory):
    """Record the first seconds of a run, with an image."""
    folder = tmp_path_factory.mktemp('bag') / 'press'
    stamps = regular_stamps(data)
    picture = SimpleNamespace(
        header=foreign_bag.header(int(stamps[0])),
        height=1,
        width=1,
        encoding='mono8',
        is_bigendian=0,
        step=1,
        data=[0],
    )
    messages = [*messages_of(data, stamps), (IMAGE, int(stamps[-1]), picture)]
    return foreign_bag.write_messages(folder, messages, TYPES)


@pytest.fixture(scope='module')
def run_folder(tmp_path_factory):
    """Leave a run in process, as `simulate` does."""
    folder = tmp_path_factory.mktemp('run') / 'pressed'
    folder.mkdir()
    setup().write(folder / 'config')
    run_of(setup(), supervised=True).data.save(folder)
    replace_json_file(folder / 'summary.json', summary_of(setup(), supervised=True))
    return folder


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def export(*arguments):
    """Call `multicontact dataset`; return what it says."""
    done = CliRunner().invoke(app, ['dataset', *map(str, arguments)])
    assert done.exit_code == 0, done.stderr
    return done.stdout


def read_bag(path):
    """Return the numbers of each topic by stamp [ns], by another decoder than the package's."""
    store = get_typestore(Stores.ROS2_JAZZY)
    numbers = {}
    with path.open('rb') as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            read = store.deserialize_cdr(message.data, schema.name)
            if schema.name == foreign_bag.JOINT_STATE:
                values = np.concatenate([read.position, read.effort])
                if channel.topic != '/joint_states':
                    values = read.effort
            elif schema.name == foreign_bag.POSE:
                at, turn = read.pose.position, read.pose.orientation
                values = np.array([at.x, at.y, at.z, turn.x, turn.y, turn.z, turn.w])
            elif channel.topic == '/ft_sensor/wrench':
                force, torque = read.wrench.force, read.wrench.torque
                values = np.array(
                    [force.x, force.y, force.z, torque.x, torque.y, torque.z]
                )
            else:
                continue
            stamp = read.header.stamp.sec * 10**9 + read.header.stamp.nanosec
            numbers.setdefault(channel.topic[1:], {})[stamp] = values
    return numbers


def read_frames(folder):
    return pd.read_parquet(folder / 'data/chunk-000/file-000.parquet')


def stack(column):
    """Return a column of pandas, of numbers or lists, as an array, shape (f, k)."""
    return np.stack([np.atleast_1d(row) for row in column])


def window_stamps(frames):
    """Return the stamps of the samples in each window [ns], to a microsecond."""
    before = np.rint(1e6 * stack(frames['window.time'])).astype(np.int64)
    return frames['recording.stamp'].to_numpy()[:, None] + 1000 * before


def test_every_number_is_that_of_the_bag(bag, tmp_path):
    said = export(bag, '--out', tmp_path / 'out', '--rate', 50, '--task', 'press both')
    frames = read_frames(tmp_path / 'out')
    numbers = read_bag(bag)
    assert len(frames) == SECONDS * 50
    for _, frame in frames.iterrows():
        stamp = frame['recording.stamp']
        joints = numbers['joint_states'][stamp]
        pose = numbers['operational_point/pose'][stamp]
        state = np.concatenate([joints[:6], pose])
        np.testing.assert_array_equal(frame['observation.state'], np.float32(state))
        effort = np.float32(joints[6:])
        np.testing.assert_array_equal(frame['observation.effort'], effort)
        for feature, topics in FEATURES.items():
            expected = np.concatenate([numbers[topic][stamp] for topic in topics])
            np.testing.assert_array_equal(frame[feature], np.float32(expected))
    for row, stamps in enumerate(window_stamps(frames)):
        for feature, topic in WINDOWS.items():
            expected = np.float32([numbers[topic][stamp] for stamp in stamps])
            found = frames[feature][row].reshape(len(stamps), -1)
            np.testing.assert_array_equal(found, expected)
    assert f'images are left out: /{IMAGE}' in said


def test_windows_of_all_frames_are_all_samples_each_once(bag, data, tmp_path):
    export(bag, '--out', tmp_path / 'out', '--rate', 20)
    frames = read_frames(tmp_path / 'out')
    stamps = window_stamps(frames)
    assert stamps.shape == (SECONDS * 20, 25)
    np.testing.assert_array_equal(stamps.ravel(), regular_stamps(data))
    np.testing.assert_array_equal(stamps[:, -1], frames['recording.stamp'])
    timestamps = np.float32(np.arange(len(frames)) / 20)
    np.testing.assert_array_equal(frames['timestamp'], timestamps)


def test_window_times_are_true_where_samples_are_late_or_lost(data, tmp_path, rng):
    """A lost sample is replaced by an earlier one; a long gap parts two episodes."""
    jitter = rng.integers(-300, 300, data.ticks) * 1000  # ns
    stamps = regular_stamps(data) + jitter
    lost = rng.choice(np.arange(1, data.ticks), 40, replace=False)
    stamps[lost] = 0
    stamps[300:400] = 0
    path = foreign_bag.write_messages(
        tmp_path / 'bag', messages_of(data, stamps), TYPES
    )
    export(path, '--out', tmp_path / 'out', '--rate', 50)
    frames = read_frames(tmp_path / 'out')
    measured = read_bag(path)['contact_forces/measured']
    there = np.array(sorted(measured))
    for row, window in enumerate(window_stamps(frames)):
        last = np.searchsorted(there, window[-1])
        np.testing.assert_array_equal(window, there[last - 9 : last + 1])
        expected = np.float32([measured[stamp] for stamp in window])
        np.testing.assert_array_equal(
            frames['window.force'][row].reshape(10, 2), expected
        )
    episodes = frames.groupby('episode_index')
    assert len(episodes) == 2
    for _, episode in episodes:
        begin = episode['recording.stamp'].iloc[0]
        since = (episode['recording.stamp'] - begin) * 1e-9
        np.testing.assert_allclose(since, episode['timestamp'], atol=0.02)
    assert (episodes['recording.stamp'].first().diff().iloc[1]) > 0.3e9


def test_recordings_become_episodes_with_tasks(bag, run_folder, tmp_path):
    out = tmp_path / 'out'
    tasks = ('--task', 'press', '--task', 'wipe', '--task', 'press')
    export(bag, run_folder, bag, '--out', out, *tasks)
    frames = read_frames(out)
    tasks = pd.read_parquet(out / 'meta/tasks.parquet')
    assert list(tasks.index) == ['press', 'wipe']
    episodes = pd.read_parquet(out / 'meta/episodes/chunk-000/file-000.parquet')
    assert [list(each) for each in episodes['tasks']] == [
        ['press'],
        ['wipe'],
        ['press'],
    ]
    assert list(episodes['recording']) == ['press', 'pressed', 'press']
    np.testing.assert_array_equal(frames['index'], np.arange(len(frames)))
    for number, episode in episodes.iterrows():
        part = frames[episode['dataset_from_index'] : episode['dataset_to_index']]
        assert len(part) == episode['length']
        assert (part['episode_index'] == number).all()
        np.testing.assert_array_equal(part['frame_index'], np.arange(len(part)))
        assert (part['task_index'] == [0, 1, 0][number]).all()


def test_frames_of_a_run_in_process_are_its_samples(run_folder, tmp_path):
    export(run_folder, '--out', tmp_path / 'out', '--rate', 500)
    frames = read_frames(tmp_path / 'out')
    with np.load(run_folder / 'samples.npz') as samples:
        for feature, series in (
            ('observation.force', 'alpha_meas'),
            ('observation.velocity', 'qd'),
            ('observation.stiffness', 'stiffness'),
        ):
            np.testing.assert_array_equal(
                stack(frames[feature]), np.float32(samples[series])
            )
        ticks = len(samples['time'])
    np.testing.assert_array_equal(
        frames['recording.stamp'], np.arange(ticks) * 2_000_000
    )
    states = stack(frames['observation.contact_state'])
    assert (states[0] == 0).all()
    assert (states[-1] == HOLDING).all()


def test_contact_states_of_a_bag_are_those_of_its_status(bag, tmp_path):
    export(bag, '--out', tmp_path / 'out', '--rate', 500)
    frames = read_frames(tmp_path / 'out')
    states = stack(frames['observation.contact_state'])
    np.testing.assert_array_equal(states[:, 0], np.arange(len(frames)) // 250)
    assert (states[:, 1] == STATE_NAMES.index('given up')).all()


def test_statistics_are_those_of_numpy(bag, run_folder, tmp_path):
    out = tmp_path / 'out'
    export(bag, run_folder, '--out', out)
    frames = read_frames(out)
    overall = json.loads((out / 'meta/stats.json').read_text())
    episodes = pq.read_table(
        out / 'meta/episodes/chunk-000/file-000.parquet'
    ).to_pylist()
    assert set(overall) == set(frames.columns)
    for feature in frames.columns:
        values = stack(frames[feature])
        parts = [(values, overall[feature])]
        for row in episodes:
            begin, end = row['dataset_from_index'], row['dataset_to_index']
            kinds = overall[feature]
            told = {kind: row[f'stats/{feature}/{kind}'] for kind in kinds}
            parts.append((values[begin:end], told))
        for part, told in parts:
            exact = part.astype(float)
            assert told['count'] == [len(part)]
            np.testing.assert_array_equal(told['min'], part.min(axis=0))
            np.testing.assert_array_equal(told['max'], part.max(axis=0))
            np.testing.assert_allclose(told['mean'], exact.mean(axis=0), rtol=1e-12)
            np.testing.assert_allclose(
                told['std'], exact.std(axis=0), rtol=1e-9, atol=1e-12
            )
            for name, share in (('q01', 0.01), ('q50', 0.5), ('q99', 0.99)):
                quantile = np.quantile(exact, share, axis=0)
                np.testing.assert_allclose(told[name], quantile, rtol=1e-12)


def test_what_a_robot_does_not_publish_is_left_out_and_named(tmp_path):
    lacking = ('ft_sensor/wrench', 'contact_forces/estimated', foreign_bag.TRUTH)
    bag = foreign_bag.write_bag(tmp_path / 'bag', without=lacking)
    said = export(bag, '--out', tmp_path / 'out', '--rate', 25)
    frames = read_frames(tmp_path / 'out')
    for feature in ('wrench', 'force_estimated', 'stiffness', 'effort'):
        assert f'observation.{feature}' in said
        assert f'observation.{feature}' not in frames
    assert stack(frames['window.force']).shape[1] == 5
    assert (stack(frames['observation.contact_state']) == -1).all()


def test_bad_input_exits_with_two_and_one_line(bag, data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    other = foreign_bag.write_messages(
        tmp_path / 'other',
        messages_of(data, regular_stamps(data), ('table', 'wall')),
        TYPES,
    )
    (tmp_path / 'taken').mkdir()
    before = sorted(tmp_path.rglob('*'))
    for arguments, message in (
        (('nowhere', '--out', 'out'), 'RUN: expected a folder of `multicontact run`'),
        ((bag, '--out', 'taken'), '--out: expected a folder that is not there yet'),
        (
            (bag, '--out', 'out', '--rate', 1000),
            '--rate: expected a whole part of the 500',
        ),
        ((bag, '--out', 'out', '--rate', 30), '20, 25, 50, 100, 125, 250, 500, got 30'),
        (
            (bag, bag, bag, '--out', 'out', '--task', 'a', '--task', 'b'),
            '--task: expected',
        ),
        (
            (bag, other, '--out', 'out'),
            'observation.force [2] force.table, force.wall in other',
        ),
    ):
        done = CliRunner().invoke(app, ['dataset', *map(str, arguments)])
        assert done.exit_code == 2
        assert message in done.stderr
        assert done.stderr.count('\n') == 1
        assert sorted(tmp_path.rglob('*')) == before


@pytest.mark.slow
def test_export_that_is_killed_leaves_no_dataset(bag, tmp_path):
    """The second recording is a pipe that nobody writes to, so that it is killed within it."""
    endless = tmp_path / 'endless'
    endless.mkdir()
    pipe = endless / 'bag.mcap'
    os.mkfifo(pipe)
    out = tmp_path / 'out'
    process = start_command('dataset', bag, endless, '--out', out)
    try:
        data = tmp_path / 'out.partial/data/chunk-000/file-000.parquet'
        wait_for(data.exists, 'the first episode')
        assert not out.exists()
    finally:
        process.kill()
        process.communicate()
    assert not out.exists()
    export(bag, '--out', out)
    assert len(read_frames(out)) == SECONDS * 50
    assert not (tmp_path / 'out.partial').exists()


READ_ALL = """
import sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
import numpy as np
dataset = LeRobotDataset('local/press', root='datasets/press')
assert dataset.num_episodes == 2 and dataset.fps == 50
frames = [dataset[k] for k in range(len(dataset))]
values = {key: np.stack([np.atleast_1d(f[key]) for f in frames]) for key in dataset.features}
np.savez('read.npz', **values, task=[f['task'] for f in frames])
history = {'window.force': [-0.02, 0.0]}
dataset = LeRobotDataset('local/press', root='datasets/press', delta_timestamps=history)
np.save('history.npy', dataset[30]['window.force'].numpy())
"""
SPLIT = '{"first": [0], "second": [1]}'


@pytest.mark.nightly
def test_lerobot_reads_every_number_trains_and_splits(bag, tmp_path, venv_python):  # noqa: F811
    """As the document says: its program and its command, in an environment of LeRobot's own."""
    install(venv_python, ['lerobot==0.4.4'])
    environment = {**os.environ, 'HF_HUB_OFFLINE': '1', 'HF_HOME': str(tmp_path / 'hf')}
    for name in (*OF_THIS_VENV, 'PYTHONPATH'):
        environment.pop(name, None)

    def run(program, *arguments):
        command = [venv_python.parent / program, *map(str, arguments)]
        done = subprocess.run(
            command, cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr[-3000:]
        return done.stdout

    folder = tmp_path / 'datasets/press'
    export(bag, bag, '--out', folder, '--task', 'press')
    run('python', '-c', READ_ALL)
    frames = read_frames(folder)
    with np.load(tmp_path / 'read.npz') as read:
        assert set(read) == {*frames.columns, 'task'}
        for feature in frames.columns:
            np.testing.assert_array_equal(read[feature], stack(frames[feature]))
        assert (read['task'] == 'press').all()
    history = stack(frames['window.force'])[29:31]
    np.testing.assert_array_equal(np.load(tmp_path / 'history.npy'), history)
    text = (ROOT / 'docs/datasets.md').read_text()
    (program,) = re.findall(r'^```py\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)
    assert 'torch.Size([30, 2]) torch.Size([3, 9]) press' in run(
        'python', '-c', program
    )
    (command,) = re.findall(
        r'^lerobot-train (.*?)^```$', text, re.MULTILINE | re.DOTALL
    )
    words = command.replace('\\\n', ' ').split()
    short = ('--steps=1', '--batch_size=2', '--num_workers=0', '--policy.device=cpu')
    run('lerobot-train', *words, *short, '--save_checkpoint=false')
    place = ('--repo_id', 'local/press', '--root', folder)
    operation = ('--operation.type', 'split', '--operation.splits', SPLIT)
    run('lerobot-edit-dataset', *place, *operation)
