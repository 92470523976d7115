"""The messages of a recording, whoever made it; needs no ROS installation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
import re
import struct
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.errors import RunError
from multicontact_control.experiment.bag_columns import BagColumns
import zstandard

# What a file that is cut off, or holds something else, makes its readers raise.
DAMAGED = (McapError, EOFError, struct.error, ValueError, LookupError, RuntimeError, OverflowError,
           TypeError, AttributeError, OSError, zstandard.ZstdError,
           MemoryError)  # a length that has been damaged may be any
NAMED = 6  # topics that a line names


@dataclass(frozen=True)
class BagMessages:
    """
    The messages of some topics of one graph.

    Attributes
    ----------
    by_topic
        What they say, by the name within the graph's namespace.
    rates
        Messages per second of all topics with more than one, by full name without the first
        slash [Hz].
    others
        Names of all other topics.
    cut_off
        Whether the recording ends in the middle.
    unreadable
        What could not be read of these topics, in words.

    """

    by_topic: Mapping[str, BagColumns]
    rates: Mapping[str, float]
    others: tuple[str, ...]
    cut_off: bool = False
    unreadable: tuple[str, ...] = ()


@dataclass
class _Reading:
    """What has been read so far."""

    by_name: dict[str, BagColumns] = field(default_factory=dict)  # by full name
    counts: dict[str, tuple[int, int, int]] = field(default_factory=dict)  # first, last [ns]
    unreadable: dict[str, str] = field(default_factory=dict)
    cut_off: bool = False


def bag_files(path: Path) -> list[Path]:
    """
    Return the MCAP files of a recording in their order: one file, or those of a rosbag2 folder.

    Raises
    ------
    RunError
        If there is none.

    """
    if path.is_file():
        if path.suffix != '.mcap':
            raise RunError(f'{path}: expected an .mcap file or a folder with one')
        return [path]
    files = sorted(path.glob('*.mcap'), key=_number)
    if files:
        return files
    found = 'a database' if any(path.glob('*.db3')) else 'none' if path.is_dir() else 'nothing'
    hint = '; `ros2 bag convert` makes MCAP of it' if found == 'a database' else ''
    raise RunError(f'{path}: expected an .mcap file, found {found}{hint}')


def _number(path: Path) -> tuple[int, str]:
    """Return what rosbag2 counts the files of a recording with, bag_0, bag_1, ..., bag_10."""
    number = re.search(r'_(\d+)$', path.stem)
    return (int(number[1]) if number else -1, path.name)


def read_messages(
    path: Path, wanted: Mapping[str, str], namespace: str | None = None,
) -> BagMessages:
    """
    Read the messages of some topics, as far as the files go.

    Parameters
    ----------
    path
        An MCAP file, or a folder with those of one recording.
    wanted
        Type of each topic by its name without namespace, one of `bag_columns.FIELDS`.
    namespace
        That of the graph; if not given, the only one that such topics are in.

    Raises
    ------
    RunError
        If there is no file, or it holds the topics of several graphs.

    """
    reading = _Reading()
    for file in bag_files(path):
        _read(file, wanted, reading)
    spaces = _namespaces(reading, wanted)
    if namespace is None and len(spaces) > 1:
        names = ', '.join(f"'{space}'" for space in sorted(spaces))
        raise RunError(f'{path}: expected the topics of one graph, found the namespaces {names}; '
                       '--namespace chooses one')
    chosen = spaces.pop() if namespace is None and spaces else (namespace or '').strip('/')
    by_topic = {_split(name, wanted)[1]: found for name, found in reading.by_name.items()
                if _split(name, wanted)[0] == chosen}
    return BagMessages(
        by_topic,
        {name.lstrip('/'): (count - 1) / ((last - first) * 1e-9)
         for name, (count, first, last) in reading.counts.items() if last > first},
        tuple(sorted(set(reading.counts) - set(reading.by_name))), reading.cut_off,
        tuple(f'{name}: {why}' for name, why in reading.unreadable.items()))


def describe_others(found: BagMessages) -> str:
    """Return the names of the first other topics, for a line that says what is missing."""
    names = found.others
    more = f' and {len(names) - NAMED} more' if len(names) > NAMED else ''
    what = ', '.join(names[:NAMED]) + more if names else 'nothing'
    return what + (', and a file that is cut off' if found.cut_off else '')


def _namespaces(reading: _Reading, wanted: Mapping[str, str]) -> set[str]:
    """Return the namespaces of the topics, without those that hold one of several only."""
    spaces = [_split(name, wanted)[0] for name in reading.by_name]
    # Grippers and the like have joint states of their own.
    whole = {space for space in spaces if spaces.count(space) > 1}
    return whole or set(spaces)


def _split(name: str, wanted: Mapping[str, str]) -> tuple[str, str]:
    """Return namespace and name within it of a topic; an empty name if it is none of them."""
    bare = name.strip('/')
    for topic in wanted:
        if bare == topic or bare.endswith(f'/{topic}'):
            return bare[:-len(topic)].strip('/'), topic
    return '', ''


def _read(path: Path, wanted: Mapping[str, str], reading: _Reading) -> None:
    factory = DecoderFactory()
    try:
        stream = path.open('rb')
    except OSError as error:
        raise RunError(f'{path}: {error.strerror}') from None
    with stream:
        # mcap's seeking reader would hold all messages before it hands out the first.
        messages = NonSeekingReader(stream).iter_messages(log_time_order=False)
        try:
            for schema, channel, record in messages:
                _take(schema, channel, record, wanted, reading, factory)
        except DAMAGED:
            reading.cut_off = True  # what came before is whole


def _take(
    schema: Any, channel: Any, record: Any, wanted: Mapping[str, str], reading: _Reading,
    factory: DecoderFactory,
) -> None:
    """Decode a message, if it is wanted."""
    name, published = channel.topic, record.publish_time or record.log_time
    count, first, _ = reading.counts.get(name, (0, published, published))
    reading.counts[name] = (count + 1, first, published)
    _, topic = _split(name, wanted)
    if not topic or name in reading.unreadable:
        return
    if schema is None or schema.name != wanted[topic]:
        kind = schema.name if schema else 'no type'
        reading.unreadable[name] = f'expected {wanted[topic]}, found {kind}'
        return
    try:
        decode = factory.decoder_for(channel.message_encoding, schema)
        if decode is None:
            raise ValueError(f'{channel.message_encoding} with {schema.encoding}')
        columns = reading.by_name.get(name) or BagColumns(wanted[topic])
        columns.take(decode(record.data), published)
    except DAMAGED as error:
        reading.unreadable[name] = f'cannot be read: {error}'
        return
    reading.by_name[name] = columns
