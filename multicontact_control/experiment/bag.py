"""Reading a recorded bag back into the series of a run; needs no ROS installation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader, NonSeekingReader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.config import ControllerConfig
from multicontact_control.errors import RunError
from multicontact_control.experiment.recording import empty_run_data, RunData
import numpy as np

Reading = Callable[[Any, Sequence[str]], Sequence[float]]


@dataclass(frozen=True)
class BagContent:
    """A bag read back: series by sample stamp, and what is known of every topic."""

    data: RunData
    topic_rates: dict[str, float]  # messages per second, of topics with more than one [Hz]
    missing: dict[str, int]  # messages that the samples call for and the bag does not hold


def bag_file(folder: Path) -> Path:
    """
    Return the MCAP file of a bag folder.

    Raises
    ------
    RunError
        If there is not just one.

    """
    files = sorted(folder.glob('*.mcap'))
    if len(files) != 1:
        raise RunError(f'{folder}: expected one .mcap file, found {len(files)}')
    return files[0]


def read_bag(folder: Path, controller: ControllerConfig) -> BagContent:
    """
    Read a recording of the graph.

    Parameters
    ----------
    folder
        The bag's folder. A file that a killed recorder left is read up to its last chunk.
    controller
        Rate, and the order of contacts and joints.

    Returns
    -------
    BagContent
        One row per sample of ``joint_states``; NaN where another message is missing.

    Raises
    ------
    RunError
        If the bag cannot be read or holds no samples.

    """
    rows: dict[str, dict[int, Any]] = {topic: {} for topic in SERIES}
    counts: dict[str, int] = {}
    spans: dict[str, tuple[int, int]] = {}
    for topic, publish_time, message in _messages(bag_file(folder)):
        topic = topic.lstrip('/')
        counts[topic] = counts.get(topic, 0) + 1
        spans[topic] = (spans.get(topic, (publish_time, 0))[0], publish_time)
        for known, stamped in rows.items():
            if topic == known or topic.endswith('/' + known):
                stamp = message.header.stamp
                stamped[stamp.sec * 1_000_000_000 + stamp.nanosec] = message
    if not rows['joint_states']:
        raise RunError(f'{folder}: expected samples on joint_states, found none')
    data, missing = _series(rows, controller)
    rates = {topic: (counts[topic] - 1) / ((last - first) * 1e-9)
             for topic, (first, last) in spans.items() if last > first}
    return BagContent(data=data, topic_rates=rates, missing=missing)


def _messages(path: Path) -> Iterator[tuple[str, int, Any]]:
    """Yield topic, publish time [ns] and message, as far as the file goes."""
    with path.open('rb') as stream:
        try:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            reader.get_summary()
        except McapError:
            stream.seek(0)
            reader = NonSeekingReader(stream, decoder_factories=[DecoderFactory()])
        try:
            for _, channel, record, message in reader.iter_decoded_messages(
                    log_time_order=False):
                yield channel.topic, record.publish_time, message
        except (McapError, EOFError):
            return  # cut off: what came before is whole


def _series(
    rows: dict[str, dict[int, Any]], controller: ControllerConfig,
) -> tuple[RunData, dict[str, int]]:
    stamps = np.array(sorted(rows['joint_states']))
    ticks = np.rint((stamps - stamps[0]) * 1e-9 * controller.rate).astype(int)
    data = empty_run_data(int(ticks[-1]) + 1, controller)
    tick_of = dict(zip(stamps.tolist(), ticks.tolist()))
    missing = {}
    for topic, readings in SERIES.items():
        names = data.joint_names if topic.startswith('joint') else data.contact_names
        found = [(tick_of[stamp], message) for stamp, message in rows[topic].items()
                 if stamp in tick_of]
        for series, read in readings.items():
            values = getattr(data, series)
            for tick, message in found:
                values[tick] = read(message, names)
        if found or topic not in OPTIONAL:
            missing[topic] = data.ticks - len(found)
    return data, missing


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
