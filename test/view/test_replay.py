"""A recording: played, paused, scrubbed through, jumped in."""

from contextlib import closing
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

from canonical_runs import run_of
from multicontact_control.errors import CommandError
from multicontact_control.files import replace_json_file
from multicontact_control.judging.run_folders import CONFIG_FOLDER, SUMMARY_FILE
from multicontact_control.nodes import messages, topics
from multicontact_control.runs.recording import RunData
from multicontact_control.runs.scenario import resolve
from multicontact_control.view import source
from multicontact_control.view.replay import load_replay, ReplaySource
import numpy as np
import pytest
from ros_graph import write_bag
from sim_bridge.surface_patch import SurfaceMarkers

PERIOD = 2_000_000  # ns


@pytest.fixture(scope='module')
def recorded_run(tmp_path_factory):
    """Return the folder of a run of 15 s, with what a replay reads."""
    folder = tmp_path_factory.mktemp('run')
    setup = resolve('quick', plant='rigid')
    result = run_of(setup)
    setup.write(folder / CONFIG_FOLDER)
    result.data.save(folder)
    events = [{'time_s': time, 'what': what} for time, what in result.events]
    summary = {'schema': 1, 'plant': 'rigid', 'seed': 0, 'events': events}
    replace_json_file(folder / SUMMARY_FILE, summary)
    return folder


@pytest.fixture
def clock(monkeypatch):
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr('multicontact_control.view.replay.monotonic', lambda: clock.now)
    return clock


@pytest.fixture
def replay(recorded_run, clock):
    return load_replay(recorded_run, resolve('paper'))


def seek(replay, moment):
    replay.give_command(source.PLAY, on=False)
    replay.give_command(source.SEEK, time=moment)
    return replay.take_snapshots()[-1]


def test_replay_plays_pauses_and_begins_anew(replay, recorded_run, clock):
    data = RunData.load(recorded_run)
    replay.give_command(source.PLAY, on=True)
    clock.now += 0.5
    (snapshot,) = replay.take_snapshots()
    assert snapshot.time == pytest.approx(0.5)
    assert snapshot.playing
    np.testing.assert_array_equal(snapshot.q, data.q[250])
    np.testing.assert_array_equal(snapshot.measured, data.alpha_meas[250])
    np.testing.assert_array_equal(snapshot.true, data.alpha_true[250])
    replay.give_command(source.SPEED, factor=2.0)
    clock.now += 0.5
    assert replay.take_snapshots()[0].time == pytest.approx(1.5)
    replay.give_command(source.PLAY, on=False)
    clock.now += 10.0
    (snapshot,) = replay.take_snapshots()
    assert snapshot.time == pytest.approx(1.5)
    assert not snapshot.playing
    assert replay.take_snapshots() == [], 'nothing has changed'
    replay.give_command(source.PLAY, on=True)
    clock.now += 10.0
    (snapshot,) = replay.take_snapshots()
    assert snapshot.time == replay.scene.duration
    assert not snapshot.playing
    np.testing.assert_array_equal(snapshot.q, data.q[-1])
    replay.give_command(source.PLAY, on=True)
    assert replay.take_snapshots()[0].time == pytest.approx(0.0)


def test_page_plays_a_recording_from_the_first_browser_to_its_end(
    replay, clock, monkeypatch
):
    page_module = pytest.importorskip(
        'multicontact_control.view.page', reason='needs viser'
    )
    with closing(page_module.Page(replay, 8472)) as page:
        page.update_page()
        monkeypatch.setattr(page.server, 'get_clients', lambda: {0: Mock()})
        for wait, moment, playing in (
            (30.0, 0.0, False),
            (0.0, 0.0, True),
            (1.0, 1.0, True),
            (30.0, replay.scene.duration, False),
        ):
            clock.now += wait
            page.update_page()
            assert page.newest.time == pytest.approx(moment)
            assert page.newest.playing == playing


def test_page_lists_each_event_once_however_often_it_is_sought(replay, monkeypatch):
    page_module = pytest.importorskip(
        'multicontact_control.view.page', reason='needs viser'
    )
    with closing(page_module.Page(replay, 8473)) as page:
        monkeypatch.setattr(page.server, 'get_clients', lambda: {0: Mock()})
        for _ in range(2):  # it begins to play
            page.update_page()
        replay.give_command(source.PLAY, on=False)
        for moment in (1.0, 2.5, 3.0, 2.0, 6.0, 9.0):
            replay.give_command(source.SEEK, time=moment)
            page.update_page()
            told = [mark for mark in replay.scene.marks if mark[0] <= moment]
            assert [*page._events] == told[-page_module.LISTED_EVENTS :]


def test_seek_shows_states_events_and_curves_of_then(replay):
    snapshot = seek(replay, 2.4)
    newest = snapshot.points[-1]
    count = 2.4 * source.RATE * source.POINTS
    assert snapshot.states == ('holding', 'holding')
    assert snapshot.reaction == 'none'
    assert len(snapshot.points) == pytest.approx(count, abs=1)
    np.testing.assert_allclose(newest[1:3], snapshot.measured, atol=2.0)
    np.testing.assert_allclose(newest[7:9], snapshot.true, atol=2.0)
    assert replay.scene.true_forces
    assert np.isfinite(snapshot.points).all()
    snapshot = seek(replay, 0.1)
    assert snapshot.states == ('free', 'free')
    assert snapshot.points[-1, 0] <= 0.1
    touched = {what: moment for moment, what in replay.scene.marks}['table impact']
    snapshot = seek(replay, touched + 0.01)
    assert snapshot.states[0] in ('impact', 'holding')
    assert any(moment == touched for moment, _ in snapshot.events)
    with pytest.raises(CommandError, match='time: expected 0 to 14.998 s, got 90 s'):
        replay.give_command(source.SEEK, time=90.0)


def test_replay_shows_what_happens_at_one_sample_in_its_order(replay, recorded_run):
    paused = [
        (1.0, 'none |  | free, free'),
        (2.0, 'hold | joints_stale | free, free'),
        (2.0, 'float | joints_stale | free, free'),
    ]
    scene = replace(replay.scene, marks=())
    played = ReplaySource(scene, RunData.load(recorded_run), paused)
    snapshot = seek(played, 2.0)
    first, second = (what for _, what in snapshot.events[-2:])
    assert snapshot.reaction == 'float'
    assert 'hold' in first
    assert 'hold' not in second


def test_replay_draws_the_whole_of_an_oscillation(replay, recorded_run):
    data = RunData.load(recorded_run)
    phase = 0.7 * np.pi * np.arange(data.ticks)  # 175 Hz
    wave = 20.0 * np.sin(phase)[:, None]
    shaken = replace(
        data, alpha_meas=data.alpha_meas + wave, innovation=data.innovation + wave
    )
    for played, extra in ((replay, 0.0), (ReplaySource(replay.scene, shaken), 20.0)):
        points = seek(played, 10.0).points
        late = points[points[:, 0] > 8.0]
        for drawn, kept in (
            (late[:, 1], data.alpha_meas[4000:5000, 0]),
            (late[:, 11], data.innovation[4000:5000, 0]),
        ):
            assert drawn.max() == pytest.approx(kept.max() + extra, abs=2.0)
            assert drawn.min() == pytest.approx(kept.min() - extra, abs=2.0)
        steps = np.diff(late[:, 1])
        assert np.abs(steps).max() > 1.5 * extra, 'both ends of each block'


def test_recording_without_a_log_shows_when_forces_were_asked_for(replay, recorded_run):
    data = RunData.load(recorded_run)
    bare = ReplaySource(replace(replay.scene, marks=()), data)
    asked = data.alpha_des[:, 0] > 0.0
    first = data.time[asked][0]
    assert seek(bare, 0.0).states[0] == 'free'
    snapshot = seek(bare, first)
    assert snapshot.states[0] == 'force'
    assert (first, 'table force') in snapshot.events


def test_replay_takes_one_namespace_of_a_file_and_its_surfaces(tmp_path):
    setup = resolve('moving_surface', plant='rigid')
    names = setup.controller.robot.joint_names
    markers = SurfaceMarkers(setup.plant, rate=500.0)

    rest = [0.0] * 6

    def rows():
        for space, count in (('left', 399), ('right', 100)):
            joints = replace(topics.JOINT_STATES, name=f'{space}/joint_states')
            for k in range(1, count + 1):
                time = PERIOD * k
                message = messages.joint_state_message(
                    time, names, position=[0.1] * 6, velocity=rest, effort=rest
                )
                yield joints, time, message
        surfaces = replace(topics.SURFACE_MARKERS, name='left/ground_truth/surfaces')
        for k in (1, 101, 201):
            time = PERIOD * k
            message = markers.build_message(time, np.full((2, 3), 1e-3 * k))
            yield surfaces, time, message

    write_bag(tmp_path / 'bag', rows())
    (file,) = (tmp_path / 'bag').glob('*.mcap')
    loaded = load_replay(file, setup, '/left')
    assert loaded.scene.duration == pytest.approx(0.796)
    for moment, place in ((0.0, 0.001), (0.19, 0.001), (0.21, 0.101), (0.7, 0.201)):
        expected = dict.fromkeys(('table', 'board'), (place,) * 3)
        assert seek(loaded, moment).places_world == expected
