"""Runs read back: the folder that a run left, or a recording of a controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math
from pathlib import Path
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
from multicontact_control.judging.metrics import RunMetrics
from multicontact_control.judging.run_folders import (
    BAG_FOLDER,
    CONFIG_FOLDER,
    is_finished_run,
    SUMMARY_FILE,
)
from multicontact_control.judging.run_modes import RECORDED
from multicontact_control.judging.run_summary import (
    list_missing,
    read_summary,
    summarise_run,
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

WHOLE_RATE = 1e-3  # of a rate, within which it is taken for one of whole Hz
JOINT_TOPICS = ('joint_states', 'joint_effort_command')  # that name the joints
CONTACT_TOPICS = (  # that name the contacts
    'contact_forces/measured',
    'contact_forces/estimated',
    'contact_forces/desired',
    'contact_forces/noise_variance',
    'ground_truth/contact_forces',
)


class LoadedRun(NamedTuple):
    """A run read back: configuration, series, and the content of ``summary.json``."""

    folder: Path
    setup: Setup
    data: recording.RunData
    summary: dict[str, Any]
    content: recording.BagContent | None = None  # of the bag; None of a run in process

    @property
    def metrics(self) -> RunMetrics:
        """Return the metrics of the run, made anew."""
        return RunMetrics(self.data, self.setup)


def load_setup(folder: Path) -> Setup:
    """
    Rebuild what a run was made with from its folder.

    Of a run that did not come to its end, and has no summary, the plant is `unknown`, the seed 0.
    Raises ConfigError if a file is missing or not acceptable.
    """
    config = folder / CONFIG_FOLDER
    if not config.is_dir():
        raise ConfigError('run', 'a folder of `multicontact run` or `simulate`', folder)

    def read_file(
        model: Any, name: str, reader: Callable[[Path], Any] = read_parameters
    ) -> Any:
        return validate(model, reader(config / name), str(config / name))

    summary: dict[str, Any] = {'plant': EXTERNAL, 'seed': 0}
    plant = NO_PLANT
    if (config / 'plant.yaml').is_file():
        summary['plant'] = 'unknown'
        plant = read_file(PlantConfig, 'plant.yaml')
    if (folder / SUMMARY_FILE).is_file():
        summary |= read_summary(folder)
    return Setup(
        scenario=read_file(ScenarioConfig, 'scenario.yaml', read_yaml),
        controller=read_file(ControllerConfig, 'controller.yaml'),
        noise_estimator=read_file(NoiseEstimatorConfig, 'noise_estimator.yaml'),
        plant=plant,
        plant_name=str(summary['plant']),
        seed=int(summary['seed']),
        urdf_dir=config,
        commanded_by_topic=bool(summary.get('commanded_by_topic')),
    )


def load_run(folder: Path | str) -> LoadedRun:
    """
    Read the folder of a run that came to its end.

    Raises ConfigError if it is none, RunError if its series are missing or cannot be read.
    """
    folder = Path(folder)
    setup = load_setup(folder)
    summary = read_summary(folder)
    bag = folder / BAG_FOLDER
    if bag.is_dir():
        content = recording.read_bag(
            bag, setup.controller, answered=not setup.simulated
        )
        summary = _update_summary(bag, setup, content, summary)
        return LoadedRun(folder, setup, content.data, summary, content)
    if (folder / recording.SERIES_FILE).is_file():
        return LoadedRun(folder, setup, recording.RunData.load(folder), summary)
    raise RunError(
        f'{folder}: expected {BAG_FOLDER}/ or {recording.SERIES_FILE}, got neither'
    )


def _update_summary(
    bag: Path, setup: Setup, content: recording.BagContent, summary: dict[str, Any]
) -> dict[str, Any]:
    """Return the summary of a run, made anew if its recording has lost something since."""
    missing = [stretch for stretch in content.missing if not math.isinf(stretch.end)]
    ticks = content.data.ticks
    rate = content.data.rate
    if ticks < summary['ticks']:
        missing.append(recording.Missing(ticks / rate, summary['ticks'] / rate))
    if not missing or missing == list_missing(summary):
        return summary
    if math.isinf(missing[0].begin):
        raise RunError(
            f'{bag}: the first part is not there, and without it forces cannot be '
            'compared with the scenario; `multicontact report` of the bag alone shows the rest'
        )
    events = None
    if summary['supervised']:
        events = [(event['time_s'], event['what']) for event in summary['events']]
    return summarise_run(
        RunMetrics(content.data, setup, missing),
        mode=summary['mode'],
        timing=summary['timing'] | {'unanswered_samples': content.unanswered},
        ended_early=summary['ended_early'] or '',
        events=events,
        remarks=content.remarks,
    )


def load(
    path: Path, files: Sequence[Path] = (), namespace: str | None = None
) -> LoadedRun:
    """
    Read the folder of a run, or a recording of a controller.

    Parameters
    ----------
    path
        The folder of a run, that of a bag, or an MCAP file.
    files
        Of a recording: the parameter files of the controller. Without any, names and rate are
        those of the messages.
    namespace
        Of a recording: that of the graph, by default the only one.

    Raises
    ------
    ConfigError
        If there is nothing, or a file is not acceptable.
    RunError
        If a recording cannot be read, or lacks what it must have.

    """
    if not path.exists():
        raise ConfigError(
            'run', 'a folder of `multicontact run` or `simulate`, or a recording', path
        )
    if is_finished_run(path):
        return load_run(path)
    if (path / BAG_FOLDER).is_dir() and not mcap_files(path):
        # A run that did not come to its end.
        own_file = path / CONFIG_FOLDER / 'controller.yaml'
        path = path / BAG_FOLDER
        if not files and own_file.is_file():
            files = (own_file,)
    messages = recording.read_graph(path, namespace)
    setup = _rebuild_setup(path, messages, files)
    content = recording.align_messages(path, messages, setup.controller, answered=True)
    remarks = list(content.remarks)
    if content.lacking:
        remarks.insert(0, f'not in the recording: {", ".join(content.lacking)}')
    summary = summarise_run(
        RunMetrics(content.data, setup, content.missing),
        mode=RECORDED,
        timing={'unanswered_samples': content.unanswered},
        remarks=remarks,
    )
    summary['supervised'] = None
    return LoadedRun(path, setup, content.data, summary, content)


def _rebuild_setup(path: Path, messages: BagMessages, files: Sequence[Path]) -> Setup:
    """Return what files, or else messages, say of what a recording was made with."""
    urdf_dir = Path()
    if files:
        read = read_controller_files(files)
        controller = read.config()
        urdf_dir = read.urdf_dir
    else:
        controller = _infer_controller(path, messages)
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


def _infer_controller(path: Path, messages: BagMessages) -> ControllerConfig:
    """Return what the messages of a recording tell of its controller: names and rate alone."""
    robot = RobotConfig.model_construct(
        urdf='',
        joint_names=_find_names(messages, JOINT_TOPICS),
        operational_frame='',
        sensor_frame='',
    )
    types = infer_contact_types(_find_names(messages, CONTACT_TOPICS))
    contacts = {
        name: ContactConfig.model_construct(type=kind) for name, kind in types.items()
    }
    return ControllerConfig.model_construct(
        rate=_find_rate(path, messages),
        robot=robot,
        contact_names=tuple(types),
        contacts=contacts,
    )


def _find_names(messages: BagMessages, topics: Sequence[str]) -> tuple[str, ...]:
    """Return the names in the first message of the first topic that has any."""
    for topic in topics:
        if topic in messages.by_topic and messages.by_topic[topic].names:
            return messages.by_topic[topic].names
    return ()


def _find_rate(path: Path, messages: BagMessages) -> float:
    """Return the rate of the samples' stamps without their gaps [Hz], whole if it nearly is."""
    topic = recording.find_sample_topic(messages)
    periods = np.diff(np.unique(messages.by_topic[topic].stamps))  # ns
    if not len(periods):
        raise RunError(f'{path}: {topic}: expected at least 2 samples, got 1')
    median = np.median(periods)
    usual = np.abs(periods - median) <= 0.5 * median
    rate = 1e9 / float(np.mean(periods[usual]))
    whole = float(round(rate))
    if abs(rate - whole) <= WHOLE_RATE * rate:
        return whole
    return rate


def infer_contact_types(names: Sequence[str]) -> dict[str, ContactType]:
    """
    Return the types of contacts by name, from the names of forces and couples.

    A recording names its columns only: `blade/along` beside `blade` makes an edge, a couple
    across, too, a plane. Configured contacts tell their type themselves.
    """
    along = SUFFIXES[ALONG]
    across = SUFFIXES[ACROSS]
    types: dict[str, ContactType] = {}
    for name in names:
        if name.endswith((along, across)):
            continue
        if name + across in names:
            types[name] = 'plane'
        elif name + along in names:
            types[name] = 'edge'
        else:
            types[name] = 'point'
    return types
