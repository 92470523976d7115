"""The folder a run leaves: made without losing what is there, read back, and ``summary.json``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from itertools import count
import math
import os
from pathlib import Path
import shutil
from typing import Any, NamedTuple

from multicontact_control.config import (
    ControllerConfig,
    NoiseEstimatorConfig,
    read_parameters,
    read_yaml,
    RobotConfig,
    validate,
)
from multicontact_control.config.contact import (
    ACROSS,
    ALONG,
    ContactConfig,
    ContactType,
    SUFFIXES,
)
from multicontact_control.errors import ConfigError, RunError
from multicontact_control.files import read_json_file, replace_nonfinite_numbers
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.verdict import (
    judge,
    LOOP_IS_STABLE,
    losses_seen,
    RECORDED,
)
from multicontact_control.runs import recording
from multicontact_control.runs.bag import BagMessages, mcap_files
from multicontact_control.runs.scenario import (
    EXTERNAL,
    NO_PLANT,
    read_controller_files,
    ScenarioConfig,
    Setup,
    UNTIL_STOPPED,
)
import numpy as np
from sim_bridge.config import PlantConfig

SUMMARY_FILE, SCHEMA = 'summary.json', 1
REPORT_FILE = 'report.html'
CONFIG_FOLDER, BAG_FOLDER, FIGURE_FOLDER, LOG_FOLDER = (
    'config',
    'bag',
    'figures',
    'logs',
)
# All that a run and its report leave, and all that is ever deleted.
LEFT_BY_RUNS = frozenset(
    (
        CONFIG_FOLDER,
        BAG_FOLDER,
        FIGURE_FOLDER,
        LOG_FOLDER,
        SUMMARY_FILE,
        REPORT_FILE,
        recording.SERIES_FILE,
    )
)
WHOLE = 1e-3  # of a rate, within which it is taken for one of whole Hz
RUNS = Path('runs')  # where runs are kept that are not told another place
NAMED_BY = (
    'contact_forces/measured',
    'contact_forces/estimated',
    'contact_forces/desired',
    'contact_forces/noise_variance',
    'ground_truth/contact_forces',
)


@contextmanager
def run_folder(
    out: Path | None,
    scenario: str,
    *,
    overwrite: bool,
    now: datetime,
) -> Iterator[Path]:
    """
    Yield the folder of a run, as `prepare_folder` makes it; remove it if the run leaves nothing.

    ``runs/latest`` leads to a folder with a summary or a recording.
    """
    folder = prepare_folder(out, scenario, overwrite=overwrite, now=now)
    try:
        yield folder
    finally:
        if not any((folder / name).exists() for name in (SUMMARY_FILE, LOG_FOLDER)):
            shutil.rmtree(folder, ignore_errors=True)
        elif (folder / SUMMARY_FILE).is_file() or mcap_files(folder / BAG_FOLDER):
            _link_latest(folder)


def _link_latest(folder: Path) -> None:
    """Let ``runs/latest`` lead to a folder."""
    RUNS.mkdir(exist_ok=True)
    fresh = RUNS / f'.latest-{os.getpid()}'
    fresh.unlink(missing_ok=True)
    fresh.symlink_to(os.path.relpath(folder.resolve(), RUNS.resolve()))
    fresh.replace(RUNS / 'latest')


def prepare_folder(
    out: Path | None, scenario: str, *, overwrite: bool, now: datetime
) -> Path:
    """
    Make and return the folder of a run, empty of any earlier run.

    Without `out` it is ``runs/<date>-<time>-<scenario>``, numbered if that is taken. ConfigError
    if it cannot be made, or `out` holds anything but a run that `overwrite` lets it delete.
    """
    folder = out or RUNS / f'{now:%Y%m%d-%H%M%S}-{scenario}'
    try:
        if out is None:
            return _make_numbered(folder)
        # Where a link leads now: `runs/latest` leads elsewhere as soon as another run begins.
        folder = (
            Path(os.path.realpath(out)) if out.is_symlink() or not out.name else out
        )
        _empty(folder, overwrite=overwrite)
    except OSError as error:
        raise ConfigError(
            'out',
            'a folder that can be made, or whose run can be replaced',
            f'{out or folder} ({error.strerror})',
        ) from None
    return folder


def _make_numbered(folder: Path) -> Path:
    """Make and return a new folder, with -2, -3, ... where it exists."""
    for number in count(1):
        numbered = (
            folder if number == 1 else folder.with_name(f'{folder.name}-{number}')
        )
        with suppress(FileExistsError):
            numbered.mkdir(parents=True)
            break
    return numbered


def _empty(folder: Path, *, overwrite: bool) -> None:
    """Make a folder, or empty it of a run; ConfigError if it holds what must be kept."""
    folder.mkdir(parents=True, exist_ok=True)
    names = {entry.name for entry in folder.iterdir()}
    if not names:
        return
    if names - LEFT_BY_RUNS or not (folder / CONFIG_FOLDER / 'scenario.yaml').is_file():
        raise ConfigError(
            'out',
            'a new or empty folder, or that of a run',
            f'{folder}, which holds {min(names - LEFT_BY_RUNS or names)}',
        )
    if not overwrite:
        raise ConfigError(
            'out',
            'a folder without a run, or --overwrite',
            f'{folder}, which holds a run',
        )
    shutil.rmtree(folder)
    folder.mkdir()


def summarise(
    data: recording.RunData,
    setup: Setup,
    *,
    mode: str,
    timing: Mapping[str, Any],
    ended_early: str = '',
    events: Sequence[tuple[float, str]] | None = None,
    missing: Sequence[recording.Missing] = (),
    remarks: Sequence[str] = (),
) -> dict[str, Any]:
    """
    Return the content of ``summary.json`` (schema 1).

    `mode` is ``in_process`` or one of `judge`, `ended_early` is as for `judge`, `events` of the
    supervisor are times [s] and what changed; None if there was no supervisor. `missing` are the
    stretches that the recording lacks, `remarks` what else was wrong with it.
    """
    # What the supervisor did after the run is not part of it.
    during = [
        (time, what) for time, what in events or () if time < data.ticks / data.rate
    ]
    verdict = judge(
        data, setup, mode=mode, ended_early=ended_early, events=during, missing=missing
    )
    run = RunMetrics(data, setup, missing)
    named = [recording.describe_missing(missing)] if missing else []
    contacts = {
        name: run.contact_summary(i) for i, name in enumerate(data.contact_names)
    }
    if events is not None:
        for name, losses in losses_seen(run, during).items():
            contacts[name]['controller_losses'] = losses
    return {
        'schema': SCHEMA,
        'scenario': setup.scenario.name,
        'plant': setup.plant_name,
        'noise_estimator': setup.noise_estimator.estimator,
        'mode': mode,
        'seed': setup.seed,
        'ticks': data.ticks,
        'rate_hz': data.rate,
        'trajectory_sha256': data.trajectory_sha256(),
        'timing': timing,
        'contacts': contacts,
        'motion': run.motion_summary(),
        'torque': run.torque_summary(),
        'stable': LOOP_IS_STABLE.get(verdict.name),
        'verdict': verdict.name,
        'judged': verdict.judged,
        'quality': verdict.quality,
        'unjudged': verdict.unjudged or None,
        'instabilities': list(verdict.reasons),
        'unstable_at_s': verdict.unstable_at,
        'ended_early': ended_early or None,
        'claims': [],
        'without_truth': run.without_truth(),
        'missing': replace_nonfinite_numbers(
            [{'from_s': begin, 'to_s': end} for begin, end in missing]
        ),
        'remarks': [*named, *_bounded_variances(data, setup), *remarks],
        'commanded_by_topic': setup.commanded_by_topic,
        'supervised': events is not None,
        'events': [{'time_s': round(time, 6), 'what': what} for time, what in during],
    }


def _bounded_variances(data: recording.RunData, setup: Setup) -> Iterator[str]:
    """Yield a remark for each contact whose R was at a bound, and how often."""
    bounds = setup.controller.noise_variance
    for name, variance in zip(data.contact_names, data.noise_variance.T):
        for what, reached in (
            ('smallest', variance <= bounds.smallest),
            ('largest', variance >= bounds.largest),
        ):
            if reached.any():
                yield (
                    f'{name}: R is the {what} that it may be, {getattr(bounds, what):g} N^2 '
                    f'(noise_variance.{what}), in {100.0 * reached.mean():.2g} % of the '
                    'samples'
                )


class LoadedRun(NamedTuple):
    """A run read back: configuration, series, and the content of ``summary.json``."""

    folder: Path
    setup: Setup
    data: recording.RunData
    summary: dict[str, Any]


def read_summary(folder: Path) -> dict[str, Any]:
    """Return the content of ``summary.json``; ConfigError if there is none, or it is none."""
    if not (folder / SUMMARY_FILE).is_file():
        raise ConfigError(
            str(folder),
            f'a run with {SUMMARY_FILE}',
            'one without, which did not come to its end',
            hint='`multicontact report` reads what was recorded',
        )
    summary = read_json_file(folder / SUMMARY_FILE)
    if not isinstance(summary, dict) or summary.get('schema') != SCHEMA:
        raise ConfigError(
            str(folder / SUMMARY_FILE), f'the summary of a run (schema {SCHEMA})'
        )
    return summary


def load_setup(folder: Path) -> Setup:
    """
    Rebuild what a run was made with; ConfigError if a file is missing or not acceptable.

    Of a run that did not come to its end, and has no summary, the plant is `unknown`, the seed 0.
    """
    if not (folder / CONFIG_FOLDER).is_dir():
        raise ConfigError('run', 'a folder of `multicontact run` or `simulate`', folder)
    config = folder / CONFIG_FOLDER
    simulated = (config / 'plant.yaml').is_file()
    summary: dict[str, Any] = {'plant': 'unknown' if simulated else EXTERNAL, 'seed': 0}
    if (folder / SUMMARY_FILE).is_file():
        summary |= read_summary(folder)

    def read(
        model: Any, name: str, reader: Callable[[Path], Any] = read_parameters
    ) -> Any:
        return validate(model, reader(config / name), str(config / name))

    return Setup(
        scenario=read(ScenarioConfig, 'scenario.yaml', read_yaml),
        controller=read(ControllerConfig, 'controller.yaml'),
        noise_estimator=read(NoiseEstimatorConfig, 'noise_estimator.yaml'),
        plant=read(PlantConfig, 'plant.yaml') if simulated else NO_PLANT,
        plant_name=str(summary['plant']),
        seed=int(summary['seed']),
        urdf_dir=config,
        commanded_by_topic=bool(summary.get('commanded_by_topic')),
    )


def load_run(folder: Path | str) -> LoadedRun:
    """Read the folder of a run; ConfigError if it is none, RunError if it cannot be read."""
    folder = Path(folder)
    setup = load_setup(folder)
    summary = read_summary(folder)
    if (folder / BAG_FOLDER).is_dir():
        content = recording.read_bag(
            folder / BAG_FOLDER, setup.controller, answered=not setup.simulated
        )
        return LoadedRun(
            folder,
            setup,
            content.data,
            _judge_what_is_left(folder, setup, content, summary),
        )
    if (folder / recording.SERIES_FILE).is_file():
        return LoadedRun(folder, setup, recording.RunData.load(folder), summary)
    raise RunError(
        f'{folder}: expected {BAG_FOLDER}/ or {recording.SERIES_FILE}, got neither'
    )


def _judge_what_is_left(
    folder: Path,
    setup: Setup,
    content: recording.BagContent,
    summary: dict[str, Any],
) -> dict[str, Any]:
    """Return the summary of a run, made anew if its recording has lost something since."""
    missing = [each for each in content.missing if not math.isinf(each.end)]
    ticks, rate = content.data.ticks, content.data.rate
    if ticks < summary['ticks']:
        missing.append(recording.Missing(ticks / rate, summary['ticks'] / rate))
    if not missing or missing == _missing_of(summary):
        return summary
    if math.isinf(missing[0].begin):
        raise RunError(
            f'{folder / BAG_FOLDER}: the first part is not there, and without it forces cannot be '
            'compared with the scenario; `multicontact report` of the bag alone shows the rest'
        )
    events = [(event['time_s'], event['what']) for event in summary['events']]
    return summarise(
        content.data,
        setup,
        mode=summary['mode'],
        timing=summary['timing'] | {'unanswered_samples': content.unanswered},
        ended_early=summary['ended_early'] or '',
        events=events if summary['supervised'] else None,
        missing=missing,
        remarks=content.remarks,
    )


def _missing_of(summary: Mapping[str, Any]) -> list[recording.Missing]:
    """Return what the recording of a run has lacked from the beginning."""
    return [
        recording.Missing(each['from_s'], each['to_s'])
        for each in summary.get('missing', ())
    ]


def _setup_of_recording(
    path: Path, messages: BagMessages, files: Sequence[Path]
) -> Setup:
    """Return what files, or else messages, say of what a recording was made with."""
    urdf_dir = Path()
    if files:
        read = read_controller_files(files)
        controller, urdf_dir = read.config(), read.urdf_dir
    else:
        robot = RobotConfig.model_construct(
            urdf='',
            joint_names=_names(messages, ('joint_states', 'joint_effort_command')),
            operational_frame='',
            sensor_frame='',
        )
        types = contact_types(_names(messages, NAMED_BY))
        controller = ControllerConfig.model_construct(
            rate=_rate(path, messages),
            robot=robot,
            contact_names=tuple(types),
            contacts={
                name: ContactConfig.model_construct(type=kind)
                for name, kind in types.items()
            },
        )
    unknown: Any = 'noise estimator not known'
    estimator = NoiseEstimatorConfig.model_construct(
        estimator=unknown, contact_names=controller.column_names, rate=controller.rate
    )
    return Setup(
        scenario=ScenarioConfig(name=path.stem or 'recording', duration=UNTIL_STOPPED),
        controller=controller,
        noise_estimator=estimator,
        plant=NO_PLANT,
        plant_name=EXTERNAL,
        seed=0,
        urdf_dir=urdf_dir,
        commanded_by_topic=True,
    )


def _names(messages: BagMessages, topics: Sequence[str]) -> tuple[str, ...]:
    """Return the names in the first message of the first topic that has any."""
    named = (
        messages.by_topic[topic].names for topic in topics if topic in messages.by_topic
    )
    return next(filter(None, named), ())


def _rate(path: Path, messages: BagMessages) -> float:
    """Return the rate of the samples' stamps without their gaps [Hz], whole if it nearly is."""
    topic = recording.find_sample_topic(messages)
    apart = np.diff(np.unique(messages.by_topic[topic].stamps))
    if not len(apart):
        raise RunError(f'{path}: {topic}: expected at least 2 samples, got 1')
    usual = np.median(apart)
    rate = 1e9 / float(np.mean(apart[np.abs(apart - usual) <= 0.5 * usual]))
    return float(round(rate)) if abs(rate - round(rate)) <= WHOLE * rate else rate


def contact_types(names: Sequence[str]) -> dict[str, ContactType]:
    """Return the types of contacts by name, from the names of forces and couples."""
    along, across = SUFFIXES[ALONG], SUFFIXES[ACROSS]
    return {
        name: 'plane'
        if name + across in names
        else 'edge'
        if name + along in names
        else 'point'
        for name in names
        if not name.endswith((along, across))
    }


def run_of(path: Path) -> tuple[Path, bool]:
    """Return the folder of a recording, of a run's ``bag/`` the run's, and whether it is a run."""
    folder = path.parent if path.is_file() else path
    folder = folder.parent if folder.name == BAG_FOLDER else folder
    return folder, (folder / CONFIG_FOLDER).is_dir()


def is_whole_run(path: Path) -> bool:
    """Return whether a path is the folder of a run that came to its end."""
    return (path / CONFIG_FOLDER).is_dir() and (path / SUMMARY_FILE).is_file()


def load(
    path: Path, files: Sequence[Path] = (), namespace: str | None = None
) -> LoadedRun:
    """
    Read the folder of a run, or a recording of a controller: a bag's folder, or an MCAP file.

    Of a recording `files` are the parameter files of the controller; without any, names and rate
    are those of the messages. `namespace` is that of the graph, by default the only one. Raises
    ConfigError or RunError if there is nothing, or it cannot be read.
    """
    own, bag = path / CONFIG_FOLDER / 'controller.yaml', path / BAG_FOLDER
    if not path.exists():
        raise ConfigError(
            'run', 'a folder of `multicontact run` or `simulate`, or a recording', path
        )
    if is_whole_run(path):
        return load_run(path)
    if bag.is_dir() and not mcap_files(path):  # of a run that did not come to its end
        path, files = bag, files or ([own] if own.is_file() else ())
    messages = recording.read_graph(path, namespace)
    setup = _setup_of_recording(path, messages, files)
    content = recording.align_messages(path, messages, setup.controller, answered=True)
    remarks = list(content.remarks)
    if content.lacking:
        remarks.insert(0, f'not in the recording: {", ".join(content.lacking)}')
    summary = summarise(
        content.data,
        setup,
        mode=RECORDED,
        timing={'unanswered_samples': content.unanswered},
        missing=content.missing,
        remarks=remarks,
    )
    return LoadedRun(path, setup, content.data, {**summary, 'supervised': None})


def report_folder(path: Path) -> Path:
    """Return where the report on a path goes: into a run's folder, beside a recording."""
    if path.is_dir() and (
        (path / CONFIG_FOLDER).is_dir() or (path / BAG_FOLDER).is_dir()
    ):
        return path
    return path.resolve().with_name(f'{path.resolve().stem}-report')
