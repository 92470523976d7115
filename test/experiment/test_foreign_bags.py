"""Recordings of anybody: whatever they lack is said, and nothing is called stable by a sensor."""

import shutil
import tracemalloc

import foreign_bag
from foreign_bag import AT, COMMAND, controller_file, JOINTS, MADE, RATE, TOPICS, write_bag
from mcap.reader import NonSeekingReader
from mcap.writer import Writer
from multicontact_control.cli import app
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.bag import answered, read_bag
from multicontact_control.experiment.bag_messages import read_messages
from multicontact_control.experiment.contact_identification import read_recording
from multicontact_control.experiment.display import summary_table, verdict_lines
from multicontact_control.experiment.external import resolve_external
from multicontact_control.experiment.figures import draw_figures, interactive_figures, run_figures
from multicontact_control.experiment.judge import verdict_text
from multicontact_control.experiment.results import load
from multicontact_control.files import json_text
from multicontact_control.nodes import messages, topics
import numpy as np
import pytest
from typer.testing import CliRunner
import yaml

pytestmark = pytest.mark.ros


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Record everything but the truth, which a robot does not know."""
    return write_bag(tmp_path_factory.mktemp('foreign') / 'bag')


def shown(run):
    """Go through all that is shown of a run but the drawing of files; return the verdict."""
    summary_table(run.summary)
    verdict_lines(run.summary, 'here')
    interactive_figures(run.data, run.setup, 0)
    json_text(run.summary)
    assert not run.summary['truth'] and run.summary['stable'] is not True
    return verdict_text(run.summary)


def test_names_rate_and_commands_are_those_of_the_messages(bag):
    run = load(bag)
    assert run.data.contact_names == ('wall',)
    assert run.data.joint_names == JOINTS
    assert run.data.rate == RATE
    rates = run.summary['timing']['topic_rates_hz']
    assert rates['joint_states'] == pytest.approx(RATE) and 'contact_forces/command' not in rates
    before = run.data.time < AT
    assert not run.data.command[before].any()
    # From when the contact was made on: the way to the surface is no answer.
    np.testing.assert_array_equal(run.data.command[run.data.time >= MADE], COMMAND)
    assert not run.data.command[(run.data.time > AT) & (run.data.time < MADE)].any()
    contact = run.summary['contacts']['wall']
    assert contact['step_rise_63_s'] == pytest.approx(0.05, abs=0.012)
    assert contact['rest']['measured_error_rms_n'] == pytest.approx(0.05, rel=0.2)
    assert contact['rest']['true_error_rms_n'] is None
    assert contact['rest']['estimate_error_rms_n'] is None


@pytest.mark.parametrize(('rate', 'jitter', 'found'), [
    (250.0 / 3.0, 0.0, 250.0 / 3.0), (1000.0 / 3.0, 0.0, 1000.0 / 3.0),
    (125.0, 0.1, 125.0), (125.01, 0.0, 125.0)])
def test_rate_is_whole_only_where_the_stamps_are(tmp_path, monkeypatch, rate, jitter, found):
    """No sample overwrites its neighbour; jitter is a share of the period."""
    def late(message):
        if hasattr(message, 'header'):
            ns = messages.stamp_to_ns(message.header.stamp)
            share = np.random.default_rng(ns % 2 ** 32).uniform(-jitter, jitter)
            message.header.stamp = messages.ns_to_stamp(ns + int(share * 1e9 / rate))
        return message

    monkeypatch.setattr(foreign_bag, 'RATE', rate)
    data = load(write_bag(tmp_path / 'bag', change=late)).data
    assert data.rate == pytest.approx(found, rel=1e-9)
    assert data.ticks == round(4.0 * rate)
    assert np.isfinite(data.alpha_meas).all()


def test_what_was_answered_knows_when_it_began(tmp_path):
    whole = read_bag(
        write_bag(tmp_path / 'bag', unanswered=1.0),
        resolve_external([controller_file(tmp_path)]).setup.controller)
    part = answered(whole)
    assert part.start - whole.start == (whole.data.ticks - part.data.ticks) * round(1e9 / RATE)
    assert part.data.time[0] == 0.0


def test_nothing_is_stable_without_truth_and_all_of_it_says_so(bag, tmp_path):
    run = load(bag)
    assert shown(run) == (
        'not judged: no ground truth; by the measured forces no limit was passed')
    result = CliRunner().invoke(app, ['report', str(bag), '--out', str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert 'not in the recording: ft_sensor/wrench_filtered' in result.output
    text = (tmp_path / 'report.html').read_text(encoding='utf-8')
    assert 'no ground truth: forces as measured' in text
    assert 'measured_error_rms_n' in text and 'Not judged: they are about' in text
    assert {path.stem for path in (tmp_path / 'figures').iterdir()} == {
        'fig3_force_wall', 'fig5_motion', 'fig6_noise_variance'}
    assert all('no ground truth' in panel.label
               for panel in run_figures(run.data, run.setup)[0].panels)


def test_truth_that_somebody_publishes_is_judged_by(tmp_path):
    run = load(write_bag(tmp_path / 'bag', without=()))
    assert run.summary['truth'] and run.summary['verdict'] == 'stable'
    assert run.summary['contacts']['wall']['rest']['true_error_rms_n'] < 1e-6


def test_limit_that_the_measured_force_passes_is_named_as_such(tmp_path):
    def pushed(message):
        if getattr(message, 'name', None) == ['wall'] and 10.0 < message.effort[0] < 12.0:
            message.effort = [message.effort[0] + 60.0]
        return message

    run = load(write_bag(tmp_path / 'bag', change=pushed))
    assert shown(run).startswith('not stable by the measured forces: wall: force of 7')


@pytest.mark.parametrize('topic', TOPICS, ids=lambda topic: topic.name)
def test_recording_that_lacks_a_topic_is_shown_as_far_as_it_goes(tmp_path, topic):
    run = load(write_bag(tmp_path / 'bag', without=(topics.TRUE_FORCES, topic)))
    assert shown(run)
    draw_figures(run.data, run.setup, tmp_path, formats=())
    if topic is not topics.FORCE_COMMAND:
        assert any(topic.name in remark for remark in run.summary['remarks'])
    if topic is topics.MEASURED_FORCES:
        assert verdict_text(run.summary) == 'not judged: neither true nor measured forces'


@pytest.mark.parametrize('kept', TOPICS, ids=lambda topic: topic.name)
def test_recording_of_one_topic_is_shown_or_refused_in_a_line(tmp_path, kept):
    bag = write_bag(tmp_path / 'bag', without={*TOPICS, topics.TRUE_FORCES} - {kept}, seconds=2.0)
    if kept is topics.FORCE_COMMAND:
        with pytest.raises(RunError, match='expected samples on joint_states'):
            load(bag)
        return
    shown(load(bag))


def test_recording_without_any_of_it_says_what_is_there(tmp_path):
    bag = write_bag(tmp_path / 'bag', without={*TOPICS, topics.TRUE_FORCES})
    with pytest.raises(RunError, match='expected samples on joint_states.* found nothing'):
        load(bag)


@pytest.mark.parametrize('content', [b'', b'no bag at all' * 100, b'\x89MCAP0\r\n'])
def test_file_that_is_no_recording_is_refused_in_a_line(tmp_path, content):
    path = tmp_path / 'x.mcap'
    path.write_bytes(content)
    result = CliRunner().invoke(app, ['report', str(path)])
    assert result.exit_code == 1
    assert len(result.output.strip().splitlines()) == 1
    assert 'found nothing, and a file that is cut off' in result.output


def test_recording_that_is_cut_off_is_read_up_to_there(bag, tmp_path):
    whole, size = load(bag).data.ticks, bag.stat().st_size
    counts = []
    for share in (0.3, 0.6, 0.9):
        path = tmp_path / f'{share}.mcap'
        path.write_bytes(bag.read_bytes()[:int(share * size)])
        run = load(path)
        shown(run)
        assert 'the recording is cut off' in run.summary['remarks']
        counts.append(run.data.ticks)
    assert 0 < counts[0] < counts[1] < counts[2] <= whole
    assert 'the recording is cut off' not in load(bag).summary['remarks']


def test_damage_in_the_middle_is_not_the_end_of_the_reader(bag, tmp_path):
    path, random = tmp_path / 'x.mcap', np.random.default_rng(0)
    for _ in range(8):
        data = bytearray(bag.read_bytes())
        place = int(random.integers(100, len(data) - 100))
        data[place:place + 50] = random.bytes(50)
        path.write_bytes(data)
        try:
            shown(load(path))
        except RunError as error:
            assert '\n' not in str(error)


def test_another_robot_is_named(bag, tmp_path):
    """A parameter file of other joints, and another contact."""
    file = controller_file(tmp_path, contact_names=['floor'], contacts={'floor': {
        'normal_world': [0.0, 0.0, -1.0], 'point_operational': [0.0, 0.0, 0.0]}})
    file.write_text(file.read_text().replace('j6', 'k6').replace('- j5\n', ''))
    with pytest.raises(ConfigError, match='robot.armature: expected 5 values'):
        load(bag, [file])
    file.write_text(file.read_text().replace('armature', 'joint_speed_not_here').replace(
        'torque_limit', 'unknown_key_of_the_node'))
    with pytest.raises(ConfigError, match='robot.joint_speed_not_here: expected a known key'):
        load(bag, [file])


def test_names_that_do_not_fit_are_remarked(bag, tmp_path):
    run = load(bag, [controller_file(
        tmp_path, contact_names=['floor'], contacts={'floor': {
            'normal_world': [0.0, 0.0, -1.0], 'point_operational': [0.0, 0.0, 0.0]}})])
    assert ('contact_forces/measured: expected floor, found wall'
            in run.summary['remarks']), run.summary['remarks']
    assert shown(run) == 'not judged: neither true nor measured forces'


def test_configuration_brings_limits_and_directions(bag, tmp_path):
    run = load(bag, [controller_file(tmp_path)])
    assert run.summary['torque']['max_fraction_of_limit'] == pytest.approx(0.03)
    assert run.summary['motion']['position_rms_m'] == pytest.approx(0.0, abs=1e-9)


def test_graphs_in_one_recording_are_told_apart(tmp_path):
    left = write_bag(tmp_path / 'left', space='/left', seconds=1.0)
    right = write_bag(tmp_path / 'right', space='/arms/right', seconds=2.0)
    assert load(left).data.ticks == RATE
    both = tmp_path / 'both'
    both.mkdir()
    shutil.copy(left, both / 'both_0.mcap')
    shutil.copy(right, both / 'both_1.mcap')
    with pytest.raises(RunError, match="found the namespaces 'arms/right', 'left'"):
        load(both)
    assert load(both, namespace='/arms/right').data.ticks == 2 * RATE


def test_recording_in_several_files_is_one(bag, tmp_path):
    shutil.copy(bag, tmp_path / 'bag_0.mcap')
    shutil.copy(bag, tmp_path / 'bag_10.mcap')
    assert load(tmp_path).data.ticks == load(bag).data.ticks


def test_stamps_that_are_no_clock_are_refused(tmp_path):
    def unstamped(message):
        if hasattr(message, 'header'):
            message.header.stamp.sec = message.header.stamp.nanosec = 0
        return message

    with pytest.raises(RunError, match='expected at least 2 samples, found 1'):
        load(write_bag(tmp_path / 'bag', change=unstamped, seconds=0.5))

    def jumping(message):
        if message.header.stamp.nanosec > 900_000_000:
            message.header.stamp.sec = 7
        return message

    with pytest.raises(RunError, match='joint_states: expected stamps 8 ms apart'):
        load(write_bag(tmp_path / 'jump', change=jumping, seconds=1.0))


def test_message_of_another_type_is_remarked(bag, tmp_path):
    path = tmp_path / 'x.mcap'
    with bag.open('rb') as stream, path.open('wb') as copy:
        writer, channels = Writer(copy), {}
        writer.start()
        for schema, channel, message in NonSeekingReader(stream).iter_messages():
            if channel.id not in channels:
                name = schema.name.replace('WrenchStamped', 'WrenchStampes')
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding,
                    writer.register_schema(name, schema.encoding, schema.data))
            writer.add_message(
                channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    remarks = load(path).summary['remarks']
    assert any(remark.startswith('/ft_sensor/wrench: expected geometry_msgs/msg/WrenchStamped')
               for remark in remarks)


def test_reading_holds_no_more_than_a_chunk(bag):
    """All messages were held before the first was taken: 2 GB for ten minutes of a graph."""
    tracemalloc.start()
    try:
        found = read_messages(bag, {})
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert found.others and peak < 400_000  # B


def test_what_is_no_recording_is_said_in_a_line(tmp_path):
    with pytest.raises(ConfigError, match='or a recording, found .*nowhere'):
        load(tmp_path / 'nowhere')
    with pytest.raises(RunError, match='expected an .mcap file, found none'):
        load(tmp_path)
    (tmp_path / 'x.db3').write_text('')
    with pytest.raises(RunError, match='found a database; `ros2 bag convert`'):
        load(tmp_path)
    with pytest.raises(RunError, match='expected an .mcap file or a folder with one'):
        load(tmp_path / 'x.db3')


def test_identification_names_what_a_recording_lacks(bag, tmp_path):
    file = controller_file(tmp_path)
    data, config, base_dir = read_recording(bag, file)
    assert data.ticks and config.contact_names == ('wall',) and base_dir == tmp_path
    with pytest.raises(ConfigError, match='--config: expected the parameter file'):
        read_recording(bag, None)
    lacking = write_bag(tmp_path / 'bag', without=(topics.TRUE_FORCES, topics.WRENCH))
    with pytest.raises(RunError, match=r'expected the wrench \(ft_sensor/wrench\), found none; '
                       'not in the recording'):
        read_recording(lacking, file)


def test_identification_asks_for_the_wrench_that_the_controller_works_with(bag, tmp_path):
    with pytest.raises(RunError, match=r'expected the wrench \(ft_sensor/wrench_filtered\)'):
        read_recording(bag, controller_file(tmp_path, wrench_input='filtered'))
    content = yaml.safe_load(controller_file(
        tmp_path, wrench_input='momentum', sensor={'require_push_test': False}).read_text())
    content['controller_node']['ros__parameters']['robot']['sensor_frame'] = ''
    (tmp_path / 'felt.yaml').write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match='wrench_input: expected raw or filtered: without a '
                       'wrist sensor .*, found momentum'):
        read_recording(bag, tmp_path / 'felt.yaml')
