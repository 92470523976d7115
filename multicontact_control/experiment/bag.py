"""Reading a recorded bag back into the series of a run; needs no ROS installation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from multicontact_control.arrays import Matrix
from multicontact_control.config import ControllerConfig
from multicontact_control.config.columns import is_couple_name
from multicontact_control.errors import RunError
from multicontact_control.experiment.bag_messages import (
    BagMessages,
    describe_others,
    read_messages,
    Recorded,
)
from multicontact_control.experiment.oscillation import stretches
from multicontact_control.experiment.recording import empty_run_data, RunData
import numpy as np

Reading = Callable[[Any, Sequence[str]], Sequence[float]]
SPARSE = 20.0  # ticks per sample beyond which the stamps are no clock
NOT_RECORDED = 'not in the recording'
REACHED = 0.99  # of a command, from which on the contact that it is for has been made


@dataclass(frozen=True)
class BagContent:
    """
    A bag read back.

    Attributes
    ----------
    data
        Series by sample stamp.
    topic_rates
        Messages per second, of topics with more than one [Hz].
    missing
        Messages that the samples call for and the bag does not hold, by topic.
    remarks
        What the bag lacks, and what in it could not be read, in words.

    """

    data: RunData
    topic_rates: dict[str, float]
    missing: dict[str, int]
    remarks: tuple[str, ...] = ()


def read_bag(
    path: Path, controller: ControllerConfig, *, namespace: str | None = None,
    commanded: bool = False,
) -> BagContent:
    """
    Read a recording of the graph.

    Parameters
    ----------
    path
        The bag's folder, or its MCAP file. What a killed recorder left is read up to its last
        chunk.
    controller
        Rate, and the order of contacts and joints.
    namespace
        That of the graph; if not given, the only one in the bag.
    commanded
        Whether forces were commanded over topics, and not by a scenario.

    Returns
    -------
    BagContent
        One row per sample of ``joint_states``, without these of the topic with the most messages;
        NaN where another message is missing.

    Raises
    ------
    RunError
        If the bag cannot be read or holds no samples.

    """
    return content_of(path, read_graph(path, namespace), controller, commanded=commanded)


def read_graph(path: Path, namespace: str | None = None) -> BagMessages:
    """
    Read the messages of a graph of this package.

    Raises
    ------
    RunError
        If there are none.

    """
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
    by_stamp = {x.stamp: x.published for x in found.by_topic[topic]}
    stamps = np.array(sorted(by_stamp))
    ticks = np.rint((stamps - stamps[0]) * 1e-9 * controller.rate).astype(np.int64)
    count = int(ticks[-1]) + 1
    if count > SPARSE * len(stamps) + controller.rate or 2 * len(stamps) < len(
            found.by_topic[topic]):
        raise RunError(
            f'{path}: {topic}: expected stamps {1e3 * controller.period:g} ms apart, found '
            f'{len(found.by_topic[topic])} messages with {len(stamps)} stamps over '
            f'{(int(stamps[-1]) - int(stamps[0])) * 1e-9:.3g} s')
    data = empty_run_data(count, controller)
    missing = _fill(data, found.by_topic, dict(zip(stamps.tolist(), ticks.tolist())))
    if commanded:
        published = np.array([by_stamp[stamp] for stamp in stamps.tolist()])
        data = replace(data, command=_commands(
            data, found.by_topic.get(FORCE_COMMAND, []), published, ticks))
    return BagContent(data, dict(found.rates), missing, _remarks(found, data))


def answered(content: BagContent) -> BagContent:
    """
    Return what lies between the first and the last sample that the control law answered.

    A robot may have published before, and after; all of it is returned where none was answered.
    """
    data = content.data
    for series in (data.alpha_meas, data.torque):
        known = np.flatnonzero(np.isfinite(series).any(axis=1))
        if known.size:
            data = data.part(int(known[0]), int(known[-1]) + 1)
            break
    missing = {topic: int(np.isnan(getattr(data, next(iter(SERIES[topic])))).all(axis=1).sum())
               for topic in content.missing}
    return replace(content, data=data, missing=missing)


def _fill(
    data: RunData, messages: Mapping[str, Sequence[Recorded]], tick_of: Mapping[int, int],
) -> dict[str, int]:
    """Write the messages into series; return how many samples lack one, by topic."""
    missing = {}
    for topic, readings in SERIES.items():
        names = data.joint_names if topic.startswith('joint') else data.contact_names
        found = {x.stamp: x.message for x in messages.get(topic, ()) if x.stamp in tick_of}
        for series, read in readings.items():
            values = getattr(data, series)
            for stamp, message in found.items():
                values[tick_of[stamp]] = read(message, names)
        if found or topic not in OPTIONAL:
            missing[topic] = data.ticks - len(found)
    return missing


def _commands(
    data: RunData, messages: Sequence[Recorded], published: Any, ticks: Any,
) -> Matrix:
    """
    Return the forces that were commanded over topics, shape (m, r) [N].

    A command counts from when the contact was made: the way to the surface is no answer to it.
    Where no command was recorded it is what the controller wanted.
    """
    if not messages:
        return data.alpha_des.copy()
    command = np.zeros_like(data.alpha_des)
    order = np.argsort(published)
    for sent in messages:
        place = int(np.searchsorted(published[order], sent.published))
        begin = int(ticks[order[place]]) if place < len(order) else data.ticks
        for name, force in zip(sent.message.name, sent.message.effort):
            if name in data.contact_names:
                command[begin:, data.contact_names.index(name)] = force
    for name, asked, wanted in zip(data.contact_names, command.T, data.alpha_des.T):
        if is_couple_name(name):  # which may be commanded as a centre of pressure
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
            names = ', '.join(found.by_topic[topic][0].message.name) or 'none'
            remarks.append(f'{topic}: expected {", ".join(wanted)}, found {names}')
    if found.cut_off:
        remarks.append('the recording is cut off')
    return tuple(remarks)


def _field(name: str) -> Reading:
    """Return what reads a field of a JointState in the order of some names."""
    def read(message: Any, wanted: Sequence[str]) -> list[float]:
        by_name = dict(zip(message.name, getattr(message, name)))
        return [by_name.get(each, np.nan) for each in wanted]
    return read


def _wrench(message: Any, _: Sequence[str]) -> tuple[float, ...]:
    force, torque = message.wrench.force, message.wrench.torque
    return force.x, force.y, force.z, torque.x, torque.y, torque.z


def _position(message: Any, _: Sequence[str]) -> tuple[float, ...]:
    p = message.pose.position
    return p.x, p.y, p.z


def _quaternion(message: Any, _: Sequence[str]) -> tuple[float, ...]:
    q = message.pose.orientation
    return q.x, q.y, q.z, q.w


# What is read from the messages of a topic, by the series it goes to.
SERIES: dict[str, dict[str, Reading]] = {
    'joint_states': {
        'q': _field('position'), 'qd': _field('velocity'), 'effort': _field('effort')},
    'ft_sensor/wrench': {'wrench': _wrench},
    'ft_sensor/wrench_filtered': {'wrench_filtered': _wrench},
    'joint_effort_command': {'torque': _field('effort')},
    'contact_forces/measured': {'alpha_meas': _field('effort')},
    'contact_forces/estimated': {
        'alpha_est': _field('effort'), 'alpha_rate_est': _field('velocity')},
    'contact_forces/desired': {'alpha_des': _field('effort')},
    'contact_forces/innovation': {'innovation': _field('effort')},
    'contact_forces/stiffness': {
        'stiffness_est': _field('position'), 'stiffness_std': _field('velocity'),
        'stiffness': _field('effort')},
    'contact_forces/stability_margin': {'margin': _field('effort')},
    'contact_forces/noise_variance': {'noise_variance': _field('effort')},
    'ground_truth/contact_forces': {'alpha_true': _field('effort')},
    'operational_point/pose': {'position': _position, 'quaternion': _quaternion},
    'operational_point/pose_desired': {'position_des': _position, 'quaternion_des': _quaternion}}
# Only there where the stiffness is found on-line.
OPTIONAL = ('contact_forces/stiffness', 'contact_forces/stability_margin')
SAMPLES, MEASURED = 'joint_states', 'contact_forces/measured'
FORCE_COMMAND = 'contact_forces/command'
# Types of all topics that are read.
TYPES = dict.fromkeys((*SERIES, FORCE_COMMAND), 'sensor_msgs/msg/JointState') | {
    'ft_sensor/wrench': 'geometry_msgs/msg/WrenchStamped',
    'ft_sensor/wrench_filtered': 'geometry_msgs/msg/WrenchStamped',
    'operational_point/pose': 'geometry_msgs/msg/PoseStamped',
    'operational_point/pose_desired': 'geometry_msgs/msg/PoseStamped'}
