"""The messages of a recording as columns of numbers; needs no ROS installation."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
import re
import struct
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.arrays import Matrix
from multicontact_control.errors import RunError
import numpy as np
from numpy.typing import NDArray
import zstandard

# What a file that is cut off, or holds something else, makes its readers raise.
DAMAGED = (McapError, EOFError, struct.error, ValueError, LookupError, RuntimeError, OverflowError,
           TypeError, AttributeError, OSError, zstandard.ZstdError,
           MemoryError)  # a length that has been damaged may be any
NAMED = 6  # topics that a line names
JOINT_STATE, WRENCH, POSE = (
    'sensor_msgs/msg/JointState', 'geometry_msgs/msg/WrenchStamped',
    'geometry_msgs/msg/PoseStamped')
MARKERS = 'visualization_msgs/msg/MarkerArray'
# Names of the numbers of a field, where the message has none.
AXES = {
    'wrench': ('force.x', 'force.y', 'force.z', 'torque.x', 'torque.y', 'torque.z'),
    'point': ('x', 'y', 'z'), 'quaternion': ('x', 'y', 'z', 'w')}
Names = tuple[str, ...]
Numbers = tuple[Sequence[float], ...]


def _joint_state(message: Any) -> tuple[Names, Numbers]:
    return tuple(message.name), (message.position, message.velocity, message.effort)


def _wrench(message: Any) -> tuple[Names, Numbers]:
    force, torque = message.wrench.force, message.wrench.torque
    return (), ((force.x, force.y, force.z, torque.x, torque.y, torque.z),)


def _pose(message: Any) -> tuple[Names, Numbers]:
    p, q = message.pose.position, message.pose.orientation
    return (), ((p.x, p.y, p.z), (q.x, q.y, q.z, q.w))


def _markers(message: Any) -> tuple[Names, Numbers]:
    places = [marker.pose.position for marker in message.markers]
    return (tuple(marker.ns.rpartition('/')[2] for marker in message.markers),
            ([p.x for p in places], [p.y for p in places], [p.z for p in places]))


# Fields of the messages of a type that are kept, and what reads their names and numbers.
READERS: dict[str, tuple[Names, Callable[[Any], tuple[Names, Numbers]]]] = {
    JOINT_STATE: (('position', 'velocity', 'effort'), _joint_state),
    WRENCH: (('wrench',), _wrench), POSE: (('point', 'quaternion'), _pose),
    MARKERS: (('x', 'y', 'z'), _markers)}


class BagColumns:
    """
    The messages of one topic, in the order of the recording: 8 bytes for each of their numbers.

    Parameters
    ----------
    type_name
        One of `READERS`.

    """

    def __init__(self, type_name: str) -> None:
        self._fields, self._read = READERS[type_name]
        self._of_markers = type_name == MARKERS
        self._stamps, self._published = array('q'), array('Q')
        # Rows and numbers of messages with the same names and number of values in each field:
        # several nodes may share a topic.
        self._parts: dict[tuple[Names, tuple[int, ...]], tuple[array[int], array[float]]] = {}

    def take(self, message: Any, published: int) -> None:
        """Add a message that was sent at a time [ns since the epoch], or nothing if it fails."""
        stamp = (message.markers[0] if self._of_markers else message).header.stamp
        names, fields = self._read(message)
        numbers = array('d', [number for values in fields for number in values])
        stamps = array('q', [stamp.sec * 1_000_000_000 + stamp.nanosec])
        when = array('Q', [published])
        rows, kept = self._parts.setdefault(
            (names, tuple(map(len, fields))), (array('q'), array('d')))
        rows.append(len(self))
        kept.extend(numbers)
        self._stamps.extend(stamps)
        self._published.extend(when)

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
        return next((names for names, _ in self._parts if names), ())

    def values(self, field: str, names: Sequence[str] = ()) -> Matrix:
        """
        Return the numbers of a field, shape (m, k); NaN where a message has none of a name.

        `names` are the order of the columns, of messages with names.
        """
        names, place = AXES.get(field, names), self._fields.index(field)
        found = np.full((len(self), len(names)), np.nan)
        for (known, widths), (rows, numbers) in self._parts.items():
            known = known or AXES.get(field, ())
            first = sum(widths[:place])
            columns = dict(zip(known, range(first, first + widths[place])))
            block = np.asarray(numbers).reshape(len(rows), sum(widths))
            for column, name in enumerate(names):
                if name in columns:
                    found[rows, column] = block[:, columns[name]]
        return found


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
    by_stem = {match[1]: file for file in files  # the one that is not compressed comes last
               if (match := re.fullmatch(r'(.*)\.mcap(\.zstd?)?', file.name))}
    return [by_stem[stem] for stem in sorted(by_stem, key=_place)]


def _place(stem: str) -> tuple[int, str]:
    """Return the place of a file: rosbag2 counts bag_0, bag_1, ..., bag_10."""
    number = re.search(r'_(\d+)$', stem)
    return int(number[1]) if number else -1, stem


def bag_files(path: Path) -> list[Path]:
    """Return the MCAP files of a recording in their order, or raise RunError if there is none."""
    files = mcap_files(path)
    if files:
        return files
    if path.is_file():
        raise RunError(f'{path}: expected an .mcap file or a folder with one')
    found = 'a database' if any(path.glob('*.db3*')) else 'none' if path.is_dir() else 'nothing'
    hint = '; `ros2 bag convert` makes MCAP of it' if found == 'a database' else ''
    raise RunError(f'{path}: expected an .mcap file, found {found}{hint}')


def read_messages(
    path: Path, wanted: Mapping[str, str], namespace: str | None = None,
) -> BagMessages:
    """
    Read the messages of some topics of an MCAP file or a folder, as far as the files go.

    `wanted` has the type of each topic, one of `READERS`, by its name without namespace;
    `namespace` is that of the graph; if not given, the only one that such topics are in. Raises
    RunError if there is no file, or it holds the topics of several graphs.
    """
    reader = _Reader(wanted)
    for file in bag_files(path):
        reader.read(file)
    spaces = reader.namespaces()
    if namespace is None and len(spaces) > 1:
        names = ', '.join(f"'{space}'" for space in sorted(spaces))
        raise RunError(f'{path}: expected the topics of one graph, found the namespaces {names}; '
                       '--namespace chooses one')
    chosen = spaces.pop() if namespace is None and spaces else (namespace or '').strip('/')
    return BagMessages(
        {topic: columns for (space, topic), columns in reader.columns.items() if space == chosen},
        {name.lstrip('/'): (count - 1) / ((last - first) * 1e-9)
         for name, (count, first, last) in reader.counts.items() if last > first},
        tuple(sorted(name for name in reader.counts if reader.split(name) not in reader.columns)),
        reader.cut_off, tuple(f'{name}: {why}' for name, why in reader.unreadable.items()))


def describe_others(found: BagMessages) -> str:
    """Return the names of the first other topics, for a line that says what is missing."""
    names = found.others
    more = f' and {len(names) - NAMED} more' if len(names) > NAMED else ''
    what = ', '.join(names[:NAMED]) + more if names else 'nothing'
    return what + (', and a file that is cut off' if found.cut_off else '')


class _Reader:
    """Reads files one after the other, as far as they go."""

    def __init__(self, wanted: Mapping[str, str]) -> None:
        self._wanted = wanted
        self.columns: dict[tuple[str, str], BagColumns] = {}  # by namespace and topic
        self.counts: dict[str, tuple[int, int, int]] = {}  # by full name; first, last [ns]
        self.unreadable: dict[str, str] = {}  # by full name
        self.cut_off = False

    def split(self, name: str) -> tuple[str, str]:
        """Return namespace and name within it of a topic; an empty name if it is not wanted."""
        bare = name.strip('/')
        for topic in self._wanted:
            if bare == topic or bare.endswith(f'/{topic}'):
                return bare[:-len(topic)].strip('/'), topic
        return '', ''

    def namespaces(self) -> set[str]:
        """Return the namespaces of the topics, without those that hold one of several only."""
        spaces = [space for space, _ in self.columns]
        # Grippers and the like have joint states of their own.
        return {space for space in spaces if spaces.count(space) > 1} or set(spaces)

    def read(self, path: Path) -> None:
        """Read a file up to where it is cut off."""
        try:
            stream = path.open('rb')
        except OSError as error:
            raise RunError(f'{path}: {error.strerror}') from None
        self._factory = DecoderFactory()  # each file of a recording numbers its types anew
        with stream:
            # mcap's seeking reader would hold all messages before it hands out the first.
            whole = stream if path.suffix == '.mcap' else BufferedReader(
                zstandard.ZstdDecompressor().stream_reader(stream, read_across_frames=True))
            messages = NonSeekingReader(whole).iter_messages(log_time_order=False)
            try:
                for schema, channel, record in messages:
                    self._take(schema, channel, record)
            except DAMAGED:
                self.cut_off = True  # what came before is whole

    def _take(self, schema: Any, channel: Any, record: Any) -> None:
        """Decode a message, if it is wanted."""
        name, published = channel.topic, record.publish_time or record.log_time
        count, first, _ = self.counts.get(name, (0, published, published))
        self.counts[name] = (count + 1, first, published)
        place = self.split(name)
        kind = self._wanted.get(place[1])
        if kind is None or name in self.unreadable:
            return
        if schema is None or schema.name != kind:
            found = schema.name if schema else 'no type'
            self.unreadable[name] = f'expected {kind}, found {found}'
            return
        try:
            decode = self._factory.decoder_for(channel.message_encoding, schema)
            if decode is None:
                raise ValueError(f'{channel.message_encoding} with {schema.encoding}')
            columns = self.columns.get(place) or BagColumns(kind)
            data = record.data
            if data[:4] == zstandard.FRAME_HEADER:
                data = zstandard.decompress(data)
            columns.take(decode(data), published)
        except DAMAGED as error:
            self.unreadable[name] = f'cannot be read: {error}'
            return
        self.columns[place] = columns
