"""Recordings by others: what they lack is reported, and a sensor alone makes no run stable."""

from dataclasses import replace
import json
from pathlib import Path
import re

import foreign_bag
from foreign_bag import (
    AT,
    COMMAND,
    COMMANDED,
    controller_file,
    header,
    JOINTS,
    MADE,
    MEASURED,
    RATE,
    TOPICS,
    TRUTH,
    write_bag,
)
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer
from multicontact_control.cli.application import app
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.files import replace_json_file
from multicontact_control.judging import figure_files
from multicontact_control.judging.display import print_summary
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.report import render_figures
from multicontact_control.judging.results import load, load_run
from multicontact_control.judging.run_figures import describe_figures
from multicontact_control.judging.verdict import describe_verdict, judge_run
from multicontact_control.runs.recording import find_gaps
from multicontact_control.runs.scenario import resolve
import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner
import yaml
import zstandard

NO_FORCES = 'not judged: neither true nor measured forces'


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Record everything but the truth, which a robot does not know."""
    return write_bag(tmp_path_factory.mktemp('foreign') / 'bag')


def verdict_shown(run):
    """Go through all that is shown of a run but the drawing of files; return the verdict."""
    print_summary(Console(quiet=True), run.summary, 'here')
    render_figures(run.metrics, 'run0')
    json.dumps(run.summary, allow_nan=False)
    assert run.summary['stable'] is not True
    return describe_verdict(run.summary)


def test_names_rate_and_commands_are_those_of_the_messages(bag):
    run = load(bag)
    assert run.data.contact_names == ('wall',)
    assert run.data.joint_names == JOINTS
    assert run.data.rate == RATE
    # From when the contact was made on: the way to the surface is no answer.
    time = run.data.time
    command = run.data.command[:, 0]
    np.testing.assert_array_equal(command[time >= MADE], COMMAND)
    on_the_way = (time < MADE) & (time != AT)
    assert not command[on_the_way].any()
    contact = run.summary['contacts']['wall']
    rest = contact['rest']
    assert contact['step_rise_63_s'] == pytest.approx(0.05, abs=0.012)
    assert rest['measured_error_rms_n'] == pytest.approx(0.05, rel=0.2)
    assert rest['true_error_rms_n'] is None
    assert rest['estimate_error_rms_n'] is None


@pytest.mark.parametrize(
    ('rate', 'jitter', 'expected'),
    [(250.0 / 3.0, 0.0, 250.0 / 3.0), (125.0, 0.1, 125.0), (125.01, 0.0, 125.0)],
)
def test_rate_is_that_of_the_stamps(tmp_path, monkeypatch, rate, jitter, expected):
    def late(message):
        stamp = message.header.stamp
        ns = stamp.sec * 10**9 + stamp.nanosec
        share = np.random.default_rng(ns % 2**32).uniform(-jitter, jitter)
        message.header = header(max(ns + int(share * 1e9 / rate), 0))
        return message

    monkeypatch.setattr(foreign_bag, 'RATE', rate)
    data = load(write_bag(tmp_path / 'bag', change=late, seconds=2.4)).data
    assert data.rate == pytest.approx(expected, rel=1e-9)
    assert data.ticks == round(2.4 * rate)
    assert np.isfinite(data.alpha_meas).all()


def test_run_without_truth_is_not_judged_and_its_report_says_so(bag, tmp_path):
    run = load(bag)
    assert verdict_shown(run).startswith('not judged: no ground truth')
    result = CliRunner().invoke(app, ['report', str(bag), '--out', str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert 'ft_sensor/wrench_filtered' in result.output
    text = (tmp_path / 'report.html').read_text(encoding='utf-8')
    assert 'no ground truth' in text
    assert 'measured error rms' in text
    figures = {path.stem for path in (tmp_path / 'figures').iterdir()}
    assert figures == {'fig3_force_wall', 'fig5_motion', 'fig6_noise_variance'}
    forces = describe_figures(run.metrics)[0]
    for panel in forces.panels:
        assert 'no ground truth' in panel.label


@pytest.mark.parametrize('topic', TOPICS)
def test_recording_that_lacks_a_topic_is_shown_as_far_as_it_goes(
    tmp_path, monkeypatch, topic
):
    run = load(write_bag(tmp_path / 'bag', without=(TRUTH, topic), seconds=2.5))
    verdict = verdict_shown(run)
    monkeypatch.setattr(figure_files, 'FIGURE_FORMATS', ())
    figure_files.draw_figures(run.metrics, run.summary, tmp_path)
    if topic != COMMANDED:
        assert topic in ' '.join(run.summary['remarks'])
    if topic == MEASURED:
        assert verdict == NO_FORCES


def test_recording_that_is_cut_off_is_read_up_to_there(bag, tmp_path):
    counts = []
    content = bag.read_bytes()
    for share in (0.3, 0.6, 0.9):
        path = tmp_path / f'{share}.mcap'
        path.write_bytes(content[: int(share * len(content))])
        run = load(path)
        verdict_shown(run)
        assert 'the recording is cut off' in run.summary['remarks']
        counts.append(run.data.ticks)
    assert 0 < counts[0] < counts[1] < counts[2] <= load(bag).data.ticks
    assert 'the recording is cut off' not in load(bag).summary['remarks']


def metadata_of(folder):
    """Write what rosbag2 would say of a recording's files."""
    files = sorted(folder.glob('*.mcap'), key=lambda path: int(path.stem[4:]))
    count = 0
    for path in files:
        with path.open('rb') as stream:
            count += make_reader(stream).get_summary().statistics.message_count
    information = {
        'relative_file_paths': [path.name for path in files],
        'message_count': count,
    }
    metadata = yaml.safe_dump({'rosbag2_bagfile_information': information})
    (folder / 'metadata.yaml').write_text(metadata)


def cut(path):
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])


@pytest.mark.parametrize(
    ('damage', 'part', 'expected'),
    [
        (Path.unlink, 9, 'no samples before the first one that is there'),
        (Path.unlink, 10, 'no samples from 1.34 to 2.67 s'),
        (Path.unlink, 11, 'no samples from 2.66 s on'),
        (cut, 11, r'no samples from 3.\d+ s on'),
        (cut, 10, r'no samples from 2.\d+ to 2.67 s'),
    ],
)
def test_recording_that_lost_a_part_says_from_when_to_when_and_is_not_judged(
    tmp_path, damage, part, expected
):
    bag = write_bag(tmp_path / 'whole', without=())
    rewritten(bag, tmp_path, parts=3, writing={'chunk_size': 4096})
    metadata_of(tmp_path)
    whole = load(tmp_path)
    assert whole.summary['verdict'] == 'stable'
    assert whole.summary['missing'] == []
    damage(tmp_path / f'bag_{part}.mcap')
    out = tmp_path / 'out'
    result = CliRunner().invoke(app, ['report', str(tmp_path), '--out', str(out)])
    page = (out / 'report.html').read_text(encoding='utf-8')
    for text in (result.output, page, verdict_shown(load(tmp_path))):
        assert re.search(f'not judged: {expected}; what is there passed no limit', text)
    assert 'metadata.yaml counts' in result.output
    assert len(load(tmp_path).summary['missing']) == 1


@pytest.mark.parametrize('renamed', [False, True])
def test_recording_whose_file_has_another_name_lacks_nothing(tmp_path, renamed):
    rewritten(write_bag(tmp_path / 'whole', without=()), tmp_path)
    metadata_of(tmp_path)
    if renamed:
        (tmp_path / 'bag_9.mcap').rename(tmp_path / 'mine.mcap')
    assert load(tmp_path).summary['remarks'] == [
        'not in the recording: ft_sensor/wrench_filtered, contact_forces/innovation'
    ]


@pytest.mark.parametrize('away', [(1.4, 2.4), (1.52, 2.0)])
def test_step_is_not_judged_across_what_is_missing(tmp_path, away):
    """The command of 10 N is obeyed from 1.5 s on, unseen, or the answer to it is."""
    loaded = load(write_bag(tmp_path / 'bag', without=()))
    data = loaded.data
    setup = loaded.setup
    begin, end = away
    part = (data.time > begin) & (data.time < end)
    assert len(RunMetrics(data, setup).contacts[0].step_responses) == 1
    for name, values in vars(data).items():
        if isinstance(values, np.ndarray) and name not in ('time', 'command'):
            values[part] = np.nan
    run = RunMetrics(data, setup)
    assert run.contacts[0].step_responses == []
    assert not run.windows.loaded[part].any()
    judged = judge_run(RunMetrics(data, setup, find_gaps(data)))
    assert judged.unjudged.startswith('no samples from ')


def test_force_that_is_not_known_for_a_while_is_not_judged(tmp_path):
    run = load(write_bag(tmp_path / 'bag', without=()))
    missing = (run.data.time > 2.0) & (run.data.time < 2.3)
    run.data.alpha_true[missing] = np.nan
    run.data.alpha_meas[missing] = np.nan
    assert judge_run(run.metrics).unjudged == (
        'wall: no force from 2.01 to 2.30 s; what is there passed no limit'
    )


def test_run_whose_recording_is_damaged_later_is_judged_by_what_is_left(tmp_path):
    bag = write_bag(tmp_path / 'bag', without=())
    run = load(bag, [controller_file(tmp_path)])
    estimator = resolve('quick').noise_estimator
    replace(run.setup, noise_estimator=estimator).write(tmp_path / 'config')
    summary = {**run.summary, 'mode': 'external', 'supervised': False}
    replace_json_file(tmp_path / 'summary.json', summary)
    assert load_run(tmp_path).summary['verdict'] == 'stable'
    cut(bag)
    summary = load_run(tmp_path).summary
    assert re.match(r'no samples from \d.\d\d to 4.00 s; what', summary['unjudged'])
    assert 'the recording is cut off' in summary['remarks']


# As of a recorder that was killed: neither index, nor statistics, nor summary.
BARE = {
    'index_types': IndexType.NONE,
    'use_chunking': False,
    'use_statistics': False,
    'use_summary_offsets': False,
    'repeat_schemas': False,
    'repeat_channels': False,
}


def rewritten(bag, folder, pack=bytes, parts=1, shuffled=False, writing=None):
    """Write its messages anew, packed, into files that rosbag2 would number from 9 on."""
    with bag.open('rb') as source:
        messages = [*make_reader(source).iter_messages()]
    order = np.arange(len(messages))
    if shuffled:
        order = np.random.default_rng(0).permutation(order)
    for part, rows in enumerate(np.array_split(order, parts)):
        with (folder / f'bag_{9 + part}.mcap').open('wb') as target:
            writer = Writer(target, **(writing or {}))
            channels = {}
            writer.start()
            for schema, channel, message in (messages[row] for row in rows):
                topic = channel.topic
                if topic not in channels:
                    kind = writer.register_schema(
                        schema.name, schema.encoding, schema.data
                    )
                    channels[topic] = writer.register_channel(topic, 'cdr', kind)
                writer.add_message(
                    channels[topic],
                    message.log_time,
                    pack(message.data),
                    message.publish_time,
                )
            writer.finish()


@pytest.mark.parametrize(
    'options',
    [
        {'pack': zstandard.compress},
        {'parts': 3},
        {'shuffled': True},
        {'writing': BARE},
        {'shuffled': True, 'writing': BARE, 'parts': 2},
    ],
)
def test_recording_split_compressed_shuffled_or_without_an_index_is_read(
    bag, tmp_path, options
):
    rewritten(bag, tmp_path, **options)
    whole = sorted(tmp_path.glob('*.mcap'))[-1]  # rosbag2 compresses messages, or files
    whole.with_suffix('.mcap.zstd').write_bytes(zstandard.compress(whole.read_bytes()))
    whole.unlink()
    whole = load(bag).data
    data = load(tmp_path).data
    for field in ('q', 'alpha_meas', 'torque', 'position_des'):
        np.testing.assert_array_equal(getattr(data, field), getattr(whole, field))


def test_parameter_file_that_does_not_fit_is_refused_or_remarked(bag, tmp_path):
    torque = load(bag, [controller_file(tmp_path)]).summary['torque']
    assert torque['max_fraction_of_limit'] == pytest.approx(0.03)
    floor = {'normal_world': [0.0, 0.0, -1.0], 'point_operational': [0.0, 0.0, 0.0]}
    file = controller_file(tmp_path, contact_names=['floor'], contacts={'floor': floor})
    run = load(bag, [file])
    assert 'contact_forces/measured: expected floor, got wall' in run.summary['remarks']
    assert verdict_shown(run) == NO_FORCES
    file.write_text(file.read_text().replace('- j5\n', ''))
    with pytest.raises(ConfigError, match='robot.armature: expected 5 values'):
        load(bag, [file])


def test_path_without_a_recording_is_refused(tmp_path):
    with pytest.raises(ConfigError, match='nowhere'):
        load(tmp_path / 'nowhere')
    path = tmp_path / 'x.mcap'
    for content in (b'', b'no bag at all' * 100, b'\x89MCAP0\r\n'):
        path.write_bytes(content)
        with pytest.raises(RunError, match='expected samples on joint_states'):
            load(path)
    path.rename(tmp_path / 'x.db3')
    with pytest.raises(ConfigError, match='ros2 bag convert'):
        load(tmp_path)
