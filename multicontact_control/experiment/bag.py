"""Reading a recorded bag back into the series of a run; needs no ROS installation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import make_reader, NonSeekingReader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.arrays import Vector
from multicontact_control.errors import RunError
from multicontact_control.experiment.recording import empty_run_data, RunData
import numpy as np

RATE_WINDOW = 1.0  # s


@dataclass(frozen=True)
class BagContent:
    """
    A bag read back.

    Attributes
    ----------
    data
        The series, by sample stamp.
    topic_rates
        Messages per second of every topic that has more than one message [Hz].
    topic_counts
        Messages per topic.
    missing
        Messages per topic that the samples call for and the bag does not hold.

    """

    data: RunData
    topic_rates: dict[str, float]
    topic_counts: dict[str, int]
    missing: dict[str, int]


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


def read_bag(
    folder: Path, *, rate: float, contact_names: tuple[str, ...], joint_names: tuple[str, ...],
) -> BagContent:
    """
    Read a recording of the graph.

    Parameters
    ----------
    folder
        The bag's folder. A file that a killed recorder left is read up to its last chunk.
    rate
        Samples per second [Hz].
    contact_names, joint_names
        Order of the columns.

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
    data, missing = _series(rows, rate, contact_names, joint_names)
    rates = {topic: (counts[topic] - 1) / ((last - first) * 1e-9)
             for topic, (first, last) in spans.items() if last > first}
    return BagContent(data=data, topic_rates=rates, topic_counts=counts, missing=missing)


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
    rows: dict[str, dict[int, Any]], rate: float, contact_names: tuple[str, ...],
    joint_names: tuple[str, ...],
) -> tuple[RunData, dict[str, int]]:
    stamps = np.array(sorted(rows['joint_states']))
    ticks = np.rint((stamps - stamps[0]) * 1e-9 * rate).astype(int)
    data = empty_run_data(int(ticks[-1]) + 1, rate, contact_names, joint_names)
    tick_of = dict(zip(stamps.tolist(), ticks.tolist()))
    missing = {}
    for topic, fill in SERIES.items():
        found = 0
        for stamp, message in rows[topic].items():
            tick = tick_of.get(stamp)
            if tick is not None:
                fill(data, tick, message)
                found += 1
        missing[topic] = data.ticks - found
    return data, missing


def _named(values: Any, names: list[str], wanted: tuple[str, ...]) -> Vector:
    by_name = dict(zip(names, values))
    return np.array([by_name.get(name, np.nan) for name in wanted])


def _joint_states(data: RunData, k: int, message: Any) -> None:
    data.q[k] = _named(message.position, message.name, data.joint_names)
    data.qd[k] = _named(message.velocity, message.name, data.joint_names)
    data.effort[k] = _named(message.effort, message.name, data.joint_names)


def _torque(data: RunData, k: int, message: Any) -> None:
    data.torque[k] = _named(message.effort, message.name, data.joint_names)


def _contacts(field: str) -> Callable[[RunData, int, Any], None]:
    def fill(data: RunData, k: int, message: Any) -> None:
        getattr(data, field)[k] = _named(message.effort, message.name, data.contact_names)
    return fill


def _estimated(data: RunData, k: int, message: Any) -> None:
    data.alpha_est[k] = _named(message.effort, message.name, data.contact_names)
    data.alpha_rate_est[k] = _named(message.velocity, message.name, data.contact_names)


def _wrench(field: str) -> Callable[[RunData, int, Any], None]:
    def fill(data: RunData, k: int, message: Any) -> None:
        force, torque = message.wrench.force, message.wrench.torque
        getattr(data, field)[k] = (
            force.x, force.y, force.z, torque.x, torque.y, torque.z)
    return fill


def _pose(position: str, quaternion: str) -> Callable[[RunData, int, Any], None]:
    def fill(data: RunData, k: int, message: Any) -> None:
        p, q = message.pose.position, message.pose.orientation
        getattr(data, position)[k] = (p.x, p.y, p.z)
        getattr(data, quaternion)[k] = (q.x, q.y, q.z, q.w)
    return fill


SERIES: dict[str, Callable[[RunData, int, Any], None]] = {
    'joint_states': _joint_states,
    'ft_sensor/wrench': _wrench('wrench'),
    'ft_sensor/wrench_filtered': _wrench('wrench_filtered'),
    'joint_effort_command': _torque,
    'contact_forces/measured': _contacts('alpha_meas'),
    'contact_forces/estimated': _estimated,
    'contact_forces/desired': _contacts('alpha_des'),
    'contact_forces/innovation': _contacts('innovation'),
    'contact_forces/noise_variance': _contacts('noise_variance'),
    'ground_truth/contact_forces': _contacts('alpha_true'),
    'operational_point/pose': _pose('position', 'quaternion'),
    'operational_point/pose_desired': _pose('position_des', 'quaternion_des')}
