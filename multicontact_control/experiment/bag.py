"""The messages of a recording as columns of numbers; needs no ROS installation."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BufferedReader
from pathlib import Path
import re
from typing import Any

from mcap.reader import NonSeekingReader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.arrays import Matrix
from multicontact_control.errors import RunError
import numpy as np
from numpy.typing import NDArray
import zstandard

NAMED = 6  # topics that a line names
JOINT_STATE, WRENCH, POSE = (
    'sensor_msgs/msg/JointState', 'geometry_msgs/msg/WrenchStamped',
    'geometry_msgs/msg/PoseStamped')
MARKERS = 'visualization_msgs/msg/MarkerArray'
# Names of the numbers of a field in messages without names.
AXES = {
    'wrench': ('force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z'),
    'point': ('x', 'y', 'z'), 'quaternion': ('x', 'y', 'z', 'w')}
# What the messages of a type hold: names, and for every field its numbers.
Content = tuple[Sequence[str], Mapping[str, Sequence[float]]]
READERS: dict[str, Callable[[Any], Content]] = {
    JOINT_STATE: lambda message: (message.name, {
        field: getattr(message, field) for field in ('position', 'velocity', 'effort')}),
    WRENCH: lambda message: ((), {'wrench': [
        getattr(part, axis) for part in (message.wrench.force, message.wrench.torque)
        for axis in 'xyz']}),
    POSE: lambda message: ((), {
        'point': [getattr(message.pose.position, axis) for axis in 'xyz'],
        'quaternion': [getattr(message.pose.orientation, axis) for axis in 'xyzw']}),
    MARKERS: lambda message: ([marker.ns.rpartition('/')[2] for marker in message.markers], {
        axis: [getattr(marker.pose.position, axis) for marker in message.markers]
        for axis in 'xyz'})}


class BagColumns:
    """The messages of one topic of a type of `READERS`, in the order of the recording."""

    def __init__(self, type_name: str) -> None:
        self._type = type_name
        self._stamps, self._published = array('q'), array('Q')
        # Rows and numbers of the messages with the same names and count of numbers by field:
        # several nodes may share a topic. A number takes 8 bytes.
        self._parts: dict[tuple[Any, ...], tuple[array[int], array[float]]] = {}

    def take(self, message: Any, published: int) -> None:
        """Add a message that was sent at a time [ns since the epoch], or nothing if it fails."""
        stamp = (message.markers[0] if self._type == MARKERS else message).header.stamp
        names, content = READERS[self._type](message)
        numbers = array('d', [number for values in content.values() for number in values])
        stamps = array('q', [stamp.sec * 1_000_000_000 + stamp.nanosec])
        rows, kept = self._parts.setdefault(
            (tuple(names), *((field, len(values)) for field, values in content.items())),
            (array('q'), array('d')))
        rows.append(len(self))
        kept.extend(numbers)
        self._stamps.extend(stamps)
        self._published.append(published)

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self._stamps)

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Stamps of the headers, shape (m,) [ns]."""
        return np.array(self._stamps, dtype=np.int64)

    @property
    def published(self) -> NDArray[np.uint64]:
        """When the messages were sent, shape (m,) [ns since the epoch]."""
        return np.array(self._published, dtype=np.uint64)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the first message that has any."""
        return next((names for names, *_ in self._parts if names), ())

    def values(self, field: str, names: Sequence[str] = ()) -> Matrix:
        """
        Return the numbers of a field, shape (m, k); NaN where a message has none of a name.

        `names` are the order of the columns, of messages with names.
        """
        names = AXES.get(field, names)
        result = np.full((len(self), len(names)), np.nan)
        for (known, *widths), (rows, numbers) in self._parts.items():
            columns, first = {}, 0
            for name, width in widths:
                if name == field:
                    columns = dict(zip(known or AXES.get(field, ()), range(first, first + width)))
                first += width
            block = np.asarray(numbers).reshape(len(rows), first)
            for column, name in enumerate(names):
                if name in columns:
                    result[rows, column] = block[:, columns[name]]
        return result


@dataclass(frozen=True)
class BagMessages:
    """The messages of some topics of one graph."""

    by_topic: Mapping[str, BagColumns]  # by the name within the graph's namespace
    # Messages per second of all topics with more than one, by full name without slash [Hz].
    rates: Mapping[str, float]
    others: tuple[str, ...]  # names of all other topics
    cut_off: bool = False  # whether the recording ends in the middle
    unreadable: tuple[str, ...] = ()  # what could not be read of these topics, in words


def mcap_files(path: Path) -> list[Path]:
    """Return the MCAP files of a recording, or that file, also those compressed as a whole."""
    files = [path] if path.is_file() else sorted(path.glob('*.mcap*'), reverse=True)
    # Of a file that is there twice, the one that is not compressed comes last.
    by_stem = {match[1]: file for file in files
               if (match := re.fullmatch(r'(.*)\.mcap(\.zstd?)?', file.name))}

    def place(stem: str) -> tuple[int, str]:  # rosbag2 counts bag_0, bag_1, ..., bag_10
        number = re.search(r'_(\d+)$', stem)
        return int(number[1]) if number else -1, stem

    return [by_stem[stem] for stem in sorted(by_stem, key=place)]


def read_messages(
    path: Path, types: Mapping[str, str], namespace: str | None = None,
) -> BagMessages:
    """
    Read the messages of some topics of an MCAP file or a folder, as far as the files go.

    `types` has the type of each topic, one of `READERS`, by its name without namespace;
    `namespace` is that of the graph; if not given, the only one that such topics are in. Raises
    RunError if there is no file, or it holds the topics of several graphs.
    """
    columns: dict[tuple[str, str], BagColumns] = {}  # by namespace and topic
    counts: dict[str, tuple[int, int, int]] = {}  # by full name; first and last [ns]
    unreadable: dict[str, str] = {}
    cut_off = False
    suffix = re.compile(rf'(?:(.*)/)?({"|".join(map(re.escape, types))})')
    for record in _records(path):
        if record is None:
            cut_off = True
            continue
        schema, channel, message, decode = record
        name, published = channel.topic.strip('/'), message.publish_time or message.log_time
        count, first, _ = counts.get(name, (0, published, published))
        counts[name] = count + 1, first, published
        place = suffix.fullmatch(name)
        if place is None or name in unreadable:
            continue
        kind, key = types[place[2]], (place[1] or '', place[2])
        if schema is None or schema.name != kind:
            unreadable[name] = f'expected {kind}, found {schema.name if schema else "no type"}'
            continue
        taken = columns.get(key) or BagColumns(kind)
        try:
            taken.take(decode(), published)
        except Exception as error:  # whatever a message of another program makes of its decoder
            unreadable[name] = f'cannot be read: {error}'
        else:
            columns[key] = taken
    chosen = _namespace(path, [space for space, _ in columns], namespace)
    return BagMessages(
        {topic: taken for (space, topic), taken in columns.items() if space == chosen},
        {name: (count - 1) / ((last - first) * 1e-9)
         for name, (count, first, last) in counts.items() if last > first},
        tuple(sorted(name for name in counts if not (
            (place := suffix.fullmatch(name)) and (place[1] or '', place[2]) in columns))),
        cut_off, tuple(f'{name}: {why}' for name, why in unreadable.items()))


def _records(path: Path) -> Iterator[tuple[Any, Any, Any, Callable[[], Any]] | None]:
    """Yield schema, channel, record and decoder of every message; None where a file is cut off."""
    files = mcap_files(path)
    if not files and path.is_file():
        raise RunError(f'{path}: expected an .mcap file or a folder with one')
    if not files:
        content = 'none; `ros2 bag convert` makes MCAP of a database' if any(
            path.glob('*.db3*')) else 'none' if path.is_dir() else 'nothing'
        raise RunError(f'{path}: expected an .mcap file, found {content}')
    for file in files:
        try:
            stream: Any = file.open('rb')
        except OSError as error:
            raise RunError(f'{file}: {error.strerror}') from None
        with stream:
            # mcap's seeking reader would hold all messages before it hands out the first.
            reader = NonSeekingReader(stream if file.suffix == '.mcap' else BufferedReader(
                zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True)))
            messages = reader.iter_messages(log_time_order=False)
            factory = DecoderFactory()  # each file of a recording numbers its types anew
            while True:
                try:
                    record = next(messages, None)
                except Exception:  # many kinds, of damaged lengths, names and checksums
                    yield None
                    break
                if record is None:
                    break
                yield *record, partial(_decoded, factory, *record)


def _decoded(factory: DecoderFactory, schema: Any, channel: Any, record: Any) -> Any:
    """Return a message, also of one that rosbag2 has compressed by itself."""
    decode = factory.decoder_for(channel.message_encoding, schema)
    if decode is None:
        raise ValueError(f'{channel.message_encoding} with {schema.encoding}')
    data = record.data
    return decode(zstandard.decompress(data) if data[:4] == zstandard.FRAME_HEADER else data)


def _namespace(path: Path, spaces: Sequence[str], namespace: str | None) -> str:
    """Return the namespace of a graph: that asked for, or the only one."""
    # Grippers and the like have joint states of their own: one topic of several makes no graph.
    known = {space for space in spaces if spaces.count(space) > 1} or set(spaces)
    if namespace is None and len(known) > 1:
        names = ', '.join(f"'{space}'" for space in sorted(known))
        raise RunError(f'{path}: expected the topics of one graph, found the namespaces {names}; '
                       '--namespace chooses one')
    return known.pop() if namespace is None and known else (namespace or '').strip('/')


def describe_others(messages: BagMessages) -> str:
    """Return the names of the first other topics, for a line that says what is missing."""
    names = messages.others
    more = f' and {len(names) - NAMED} more' if len(names) > NAMED else ''
    what = ', '.join(names[:NAMED]) + more if names else 'nothing'
    return what + (', and a file that is cut off' if messages.cut_off else '')
