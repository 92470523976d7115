"""Reading a recorded bag back into the series of a run; needs no ROS installation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from multicontact_control.arrays import Matrix
from multicontact_control.config import ControllerConfig
from multicontact_control.config.contact import ACROSS, ALONG, SUFFIXES
from multicontact_control.errors import RunError
from multicontact_control.experiment.bag_messages import (
    BagColumns,
    BagMessages,
    describe_others,
    JOINT_STATE,
    POSE,
    read_messages,
    WRENCH,
)
from multicontact_control.experiment.oscillation import stretches
from multicontact_control.experiment.recording import empty_run_data, RunData
import numpy as np
from numpy.typing import NDArray

SPARSE = 20.0  # ticks per sample beyond which the stamps are no clock
CUT_OFF = 'the recording is cut off'
NOT_RECORDED = 'not in the recording'
REACHED = 0.99  # of a command, from which on the contact that it is for has been made


@dataclass(frozen=True)
class BagContent:
    """A bag read back."""

    data: RunData  # by sample stamp
    topic_rates: dict[str, float]  # messages per second, of topics with more than one [Hz]
    missing: dict[str, int]  # messages that the samples call for and the bag lacks, by topic
    remarks: tuple[str, ...] = ()  # what the bag lacks, and what could not be read, in words
    start: int = 0  # stamp of the first sample [ns]

    @property
    def told(self) -> list[str]:
        """Return what is told of a run of one's own: not every topic is in each."""
        return [text for text in self.remarks if not text.startswith(NOT_RECORDED)]


def read_bag(
    path: Path, controller: ControllerConfig, *, namespace: str | None = None,
    commanded: bool = False,
) -> BagContent:
    """
    Read a recording of the graph: a bag's folder, or its MCAP file, up to its last whole chunk.

    `controller` gives rate, contacts and joints; `namespace` is that of the graph, if not given
    the only one in the bag; `commanded` says whether forces were commanded over topics. Returns
    one row per sample of ``joint_states``, without these of the topic with the most messages; NaN
    where another message is missing. Raises RunError if the bag cannot be read or holds no
    samples.
    """
    return content_of(path, read_graph(path, namespace), controller, commanded=commanded)


def read_graph(path: Path, namespace: str | None = None) -> BagMessages:
    """Read the messages of a graph of this package; RunError if there are none."""
    found = read_messages(path, TYPES, namespace)
    if not any(topic in SERIES for topic in found.by_topic):
        unreadable = ''.join(f'; {text}' for text in found.unreadable)
        raise RunError(f'{path}: expected samples on joint_states, or another topic of the '
                       f'controller, found {describe_others(found)}{unreadable}')
    return found


def sample_topic(found: BagMessages) -> str:
    """Return the topic that has a message for every sample."""
    there = [topic for topic in SERIES if topic in found.by_topic]
    return SAMPLES if SAMPLES in there else max(there, key=lambda x: len(found.by_topic[x]))


def content_of(
    path: Path, found: BagMessages, controller: ControllerConfig, *, commanded: bool = False,
) -> BagContent:
    """Return the series of the messages that `read_graph` found; see `read_bag`."""
    topic = sample_topic(found)
    samples = found.by_topic[topic]
    stamps, newest = np.unique(samples.stamps[::-1], return_index=True)
    ticks = np.rint((stamps - stamps[0]) * 1e-9 * controller.rate).astype(np.int64)
    count = int(ticks[-1]) + 1
    if count > SPARSE * len(stamps) + controller.rate or 2 * len(stamps) < len(samples):
        raise RunError(
            f'{path}: {topic}: expected stamps {1e3 * controller.period:g} ms apart, found '
            f'{len(samples)} messages with {len(stamps)} stamps over '
            f'{(int(stamps[-1]) - int(stamps[0])) * 1e-9:.3g} s')
    data = empty_run_data(count, controller)
    missing = _fill(data, found.by_topic, stamps, ticks)
    if commanded:
        data = replace(data, command=_commands(
            data, found.by_topic.get(FORCE_COMMAND), samples.published[::-1][newest], ticks))
    return BagContent(
        data, dict(found.rates), missing, _remarks(found, data), int(stamps[0]))


def answered(content: BagContent) -> BagContent:
    """Return what lies between the first and the last sample that was answered, if any was."""
    data, start = content.data, content.start
    for series in (data.alpha_meas, data.torque):
        known = np.flatnonzero(np.isfinite(series).any(axis=1))
        if known.size:
            data = data.part(int(known[0]), int(known[-1]) + 1)
            start += round(known[0] / data.rate * 1e9)
            break
    missing = {topic: int(np.isnan(getattr(data, next(iter(SERIES[topic])))).all(axis=1).sum())
               for topic in content.missing}
    return replace(content, data=data, start=start, missing=missing)


def _fill(
    data: RunData, messages: Mapping[str, BagColumns], stamps: NDArray[np.int64],
    ticks: NDArray[np.int64],
) -> dict[str, int]:
    """Write the messages into series; return how many samples lack one, by topic."""
    missing = {}
    for topic, fields in SERIES.items():
        found = messages.get(topic)
        if found is None:
            if topic not in OPTIONAL:
                missing[topic] = data.ticks
            continue
        names = data.joint_names if topic.startswith('joint') else data.contact_names
        places = np.searchsorted(stamps, found.stamps).clip(max=len(stamps) - 1)
        of_samples = stamps[places] == found.stamps
        rows = ticks[places[of_samples]]
        for series, field in fields.items():
            getattr(data, series)[rows] = found.values(field, names)[of_samples]
        there = len(np.unique(places[of_samples]))
        if there or topic not in OPTIONAL:
            missing[topic] = data.ticks - there
    return missing


def _commands(
    data: RunData, sent: BagColumns | None, published: NDArray[np.uint64],
    ticks: NDArray[np.int64],
) -> Matrix:
    """
    Return the forces that were commanded over topics, shape (m, r) [N].

    A command counts from when the contact was made. Where no command was recorded it is what
    the controller wanted.
    """
    if sent is None:
        return data.alpha_des.copy()
    command = np.zeros_like(data.alpha_des)
    order = np.argsort(published)
    places = np.searchsorted(published[order], sent.published)
    begins = np.append(ticks[order], data.ticks)[places]
    for asked, forces in zip(command.T, sent.values('effort', data.contact_names).T):
        named = ~np.isnan(forces)
        begun = np.full(data.ticks + 1, np.nan)
        begun[0] = 0.0
        begun[begins[named]] = forces[named]
        newest = np.where(np.isnan(begun), 0, np.arange(data.ticks + 1))
        asked[:] = begun[np.maximum.accumulate(newest)][:-1]
    for name, asked, wanted in zip(data.contact_names, command.T, data.alpha_des.T):
        if name.endswith((SUFFIXES[ALONG], SUFFIXES[ACROSS])):
            # A couple may be commanded as a centre of pressure.
            asked[:] = wanted
            continue
        for begin, end in zip(*stretches(asked > 0.0)):
            reached = np.flatnonzero(wanted[begin:end] >= REACHED * asked[begin:end])
            if reached.size:
                asked[begin:begin + reached[0]] = 0.0
    return command


def _remarks(found: BagMessages, data: RunData) -> tuple[str, ...]:
    remarks = list(found.unreadable)
    lacking = [x for x in SERIES if x not in found.by_topic and x not in OPTIONAL]
    if lacking:
        remarks.append(f'{NOT_RECORDED}: {", ".join(lacking)}')
    for topic, values, wanted in ((SAMPLES, data.q, data.joint_names),
                                  (MEASURED, data.alpha_meas, data.contact_names)):
        if topic in found.by_topic and wanted and not np.isfinite(values).any():
            names = ', '.join(found.by_topic[topic].names) or 'none'
            remarks.append(f'{topic}: expected {", ".join(wanted)}, found {names}')
    if found.cut_off:
        remarks.append(CUT_OFF)
    return tuple(remarks)


# Which field of the messages of a topic a series is.
SERIES: dict[str, dict[str, str]] = {
    'joint_states': {'q': 'position', 'qd': 'velocity', 'effort': 'effort'},
    'ft_sensor/wrench': {'wrench': 'wrench'},
    'ft_sensor/wrench_filtered': {'wrench_filtered': 'wrench'},
    'joint_effort_command': {'torque': 'effort'},
    'contact_forces/measured': {'alpha_meas': 'effort'},
    'contact_forces/estimated': {'alpha_est': 'effort', 'alpha_rate_est': 'velocity'},
    'contact_forces/desired': {'alpha_des': 'effort'},
    'contact_forces/innovation': {'innovation': 'effort'},
    'contact_forces/stiffness': {
        'stiffness_est': 'position', 'stiffness_std': 'velocity', 'stiffness': 'effort'},
    'contact_forces/stability_margin': {'margin': 'effort'},
    'contact_forces/noise_variance': {'noise_variance': 'effort'},
    'ground_truth/contact_forces': {'alpha_true': 'effort'},
    'operational_point/pose': {'position': 'point', 'quaternion': 'quaternion'},
    'operational_point/pose_desired': {
        'position_des': 'point', 'quaternion_des': 'quaternion'}}
# Only there where the stiffness is found on-line.
OPTIONAL = ('contact_forces/stiffness', 'contact_forces/stability_margin')
SAMPLES, MEASURED = 'joint_states', 'contact_forces/measured'
FORCE_COMMAND = 'contact_forces/command'
# Types of all topics that are read.
TYPES = dict.fromkeys((*SERIES, FORCE_COMMAND), JOINT_STATE) | {
    'ft_sensor/wrench': WRENCH, 'ft_sensor/wrench_filtered': WRENCH,
    'operational_point/pose': POSE, 'operational_point/pose_desired': POSE}
