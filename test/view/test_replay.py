"""A recording: played, paused, scrubbed through, jumped in."""

from __future__ import annotations

import shutil

from foreign_bag import controller_file, write_bag
from multicontact_control.errors import CommandError, ConfigError, RunError
from multicontact_control.experiment.external import resolve_external
from multicontact_control.experiment.recording import RunData
from multicontact_control.experiment.scenario import resolve
from multicontact_control.files import write_json
from multicontact_control.nodes import messages, qos
from multicontact_control.nodes.bag import Bag
from multicontact_control.view import source
from multicontact_control.view.replay import load_replay, ReplaySource
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sim_bridge.surface_markers import SurfaceMarkers


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def replay(recorded_run, clock):
    loaded = load_replay(recorded_run, resolve('paper'))
    return ReplaySource(loaded.scene, RunData.load(recorded_run), loaded._events, (), clock)


def test_it_plays_what_was_recorded_as_fast_as_is_asked_for(replay, recorded_run, clock):
    data = RunData.load(recorded_run)
    clock.now += 0.5
    snapshot, = replay.poll()
    assert snapshot.time == pytest.approx(0.5) and snapshot.playing
    np.testing.assert_array_equal(snapshot.q, data.q[250])
    np.testing.assert_array_equal(snapshot.measured, data.alpha_meas[250])
    replay.command(source.SPEED, factor=2.0)
    clock.now += 0.5
    assert replay.poll()[0].time == pytest.approx(1.5)
    replay.command(source.PLAY, on=False)
    clock.now += 10.0
    snapshot, = replay.poll()
    assert snapshot.time == pytest.approx(1.5) and not snapshot.playing
    assert replay.poll() == [], 'nothing has changed'
    replay.command(source.PLAY, on=True)
    clock.now += 10.0
    snapshot, = replay.poll()
    assert snapshot.time == pytest.approx(replay.scene.duration) and not snapshot.playing
    replay.command(source.PLAY, on=True)
    assert replay.poll()[0].time == pytest.approx(0.0)


def test_scrubbing_shows_states_events_and_curves_of_then(replay, clock):
    replay.command(source.PLAY, on=False)
    replay.poll()
    replay.command(source.SEEK, time=2.5)
    snapshot, = replay.poll()
    assert snapshot.states == ('holding', 'holding')
    assert snapshot.reaction == 'none'
    assert len(snapshot.points) == pytest.approx(2.5 * source.RATE * source.POINTS, abs=1)
    np.testing.assert_allclose(snapshot.points[-1, 1:3], snapshot.measured, atol=2.0)
    assert np.isfinite(snapshot.points).all()
    replay.command(source.SEEK, time=0.1)
    snapshot, = replay.poll()
    assert snapshot.states == ('free', 'free')
    assert snapshot.points[-1, 0] <= 0.1
    with pytest.raises(CommandError, match='time: expected 0 to 2.998 s, found 9 s'):
        replay.command(source.SEEK, time=9.0)


def test_events_can_be_jumped_to(replay):
    marks = {what: moment for moment, what in replay.scene.marks}
    touched = marks['table impact']
    replay.command(source.SEEK, time=touched + 0.01)
    snapshot, = replay.poll()
    assert snapshot.states[0] in ('impact', 'holding')
    assert any(moment == touched for moment, _ in snapshot.events)


def test_a_recording_cannot_be_steered(replay):
    for name in source.STEERING:
        assert name in replay.refusals
        with pytest.raises(CommandError, match='not a recording'):
            replay.command(name)


def test_a_run_that_did_not_come_to_its_end_is_played_all_the_same(recorded_run, tmp_path):
    folder = tmp_path / 'run'
    shutil.copytree(recorded_run, folder)
    (folder / 'summary.json').unlink()
    whole, cut = load_replay(recorded_run, None), load_replay(folder, None)
    assert cut.scene.duration == whole.scene.duration
    assert 'force step' in str(cut.scene.marks)


def test_what_is_no_recording_is_refused(tmp_path, recorded_run):
    setup = resolve('paper')
    for path in (tmp_path, tmp_path / 'nothing', recorded_run / 'config'):
        with pytest.raises((ConfigError, Exception), match='expected'):
            load_replay(path, setup)


def write_samples(writer, setup, count=399, space=''):
    names, topic = setup.controller.robot.joint_names, f'{space}/joint_states'
    writer.add_topic(topic, 'sensor_msgs/msg/JointState', qos.STREAM)
    for k in range(1, count + 1):
        message = messages.joint_state_message(
            2_000_000 * k, names, position=[0.1] * 6, velocity=[0.0] * 6, effort=[0.0] * 6)
        writer.write(topic, serialize_message(message), k)
        if k % 8 == 0:
            writer.flush()


def test_a_run_on_somebody_elses_robot_is_played_in_the_time_of_its_events(tmp_path):
    setup = resolve_external([controller_file(tmp_path)]).setup
    folder = tmp_path / 'run'
    setup.write(folder / 'config')
    write_bag(folder / 'bag', seconds=3.0, unanswered=1.0)
    write_json(folder / 'summary.json', {
        'plant': 'external', 'seed': 0, 'commanded_by_topic': True,
        'events': [{'time_s': 0.5, 'what': 'none |  | impact'}]})
    loaded = load_replay(folder, resolve('paper'))
    assert loaded.scene.duration == pytest.approx(2.0 - 1.0 / 125.0)
    assert loaded.scene.marks == ((0.5, 'wall impact'),), 'nothing that a scenario asked for'
    surface, = loaded.scene.surfaces
    assert (surface.name, surface.normal_world, surface.point_world) == (
        'wall', (1.0, 0.0, 0.0), None)
    loaded.command(source.PLAY, on=False)
    loaded.command(source.SEEK, time=0.48)
    assert loaded.poll()[-1].desired[0] == 2.0
    loaded.command(source.SEEK, time=0.52)
    snapshot = loaded.poll()[-1]
    assert snapshot.desired[0] == 10.0 and snapshot.states == ('impact',)


def test_a_file_is_played_alone_and_a_namespace_chosen(tmp_path):
    setup = resolve('quick', plant='rigid')
    for name, count in (('a', 400), ('b', 200)):
        with Bag(tmp_path / name) as writer:
            write_samples(writer, setup, count)
        shutil.copy(tmp_path / name / f'{name}.mcap', tmp_path / f'{name}.mcap')
    for name, count in (('a', 400), ('b', 200)):
        scene = load_replay(tmp_path / f'{name}.mcap', setup).scene
        assert scene.title == f'recording {name}.mcap'
        assert scene.duration == pytest.approx((count - 1) * 0.002)
    with Bag(tmp_path / 'two') as writer:
        write_samples(writer, setup, 300, '/left')
        write_samples(writer, setup, 100, '/right')
    with pytest.raises(RunError, match="found the namespaces 'left', 'right'; --namespace choos"):
        load_replay(tmp_path / 'two', setup)
    for space, count in (('left', 300), ('/right', 100)):
        scene = load_replay(tmp_path / 'two', setup, space).scene
        assert scene.duration == pytest.approx((count - 1) * 0.002)


def test_surfaces_are_where_the_simulator_said_that_they_were(tmp_path):
    setup = resolve('moving_surface', plant='rigid')
    markers = SurfaceMarkers(setup.plant, rate=500.0)
    with Bag(tmp_path / 'bag') as writer:
        write_samples(writer, setup)
        writer.add_topic(
            '/ground_truth/surfaces', 'visualization_msgs/msg/MarkerArray', qos.LATCHED)
        for k in (1, 101, 201):
            message = markers.message(2_000_000 * k, np.full((2, 3), 1e-3 * k))
            writer.write('/ground_truth/surfaces', serialize_message(message), k)
    loaded = load_replay(tmp_path / 'bag', setup)
    for moment, place in ((0.0, 0.001), (0.19, 0.001), (0.21, 0.101), (0.7, 0.201)):
        loaded.command(source.SEEK, time=moment)
        loaded.command(source.PLAY, on=False)
        snapshot = loaded.poll()[-1]
        assert snapshot.places_world == {name: (place,) * 3 for name in ('table', 'board')}


def test_what_cannot_be_read_is_bad_input_and_what_is_cut_off_is_said_so(recorded_run, tmp_path):
    pytest.importorskip('viser', reason='viser is not installed (extra [view])')
    run = pytest.importorskip('multicontact_control.view.run')
    setup = resolve('quick', plant='rigid')
    folder = tmp_path / 'run'
    shutil.copytree(recorded_run / 'config', folder / 'config')
    shutil.copy(recorded_run / 'summary.json', folder)
    with Bag(folder / 'bag') as writer:
        write_samples(writer, setup)
    assert load_replay(folder, setup).scene.title == 'recording run'
    file = folder / 'bag' / 'bag.mcap'
    whole = file.read_bytes()
    file.write_bytes(whole[:len(whole) // 2])
    assert load_replay(folder, setup).scene.title == 'recording run, the recording is cut off'
    file.write_bytes(whole[:50])
    with pytest.raises(ConfigError, match='recording: expected one that can be read, found none: '
                                          '.*found nothing, and a file that is cut off$'):
        run.make_source(setup, run.ViewOptions(recording=folder))
