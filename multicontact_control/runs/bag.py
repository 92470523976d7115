"""The messages of a recording as columns of numbers; needs no ROS installation."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BufferedReader
from pathlib import Path
import re
from textwrap import shorten
from typing import Any, NamedTuple

from mcap.reader import NonSeekingReader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.arrays import Matrix
from multicontact_control.config import read_yaml
from multicontact_control.errors import ConfigError, RunError
import numpy as np
from numpy.typing import NDArray
import zstandard

WIDTH = 200  # characters of the topics that a line names
METADATA = (
    'metadata.yaml'  # of rosbag2: which files a recording has, and how many messages
)
JOINT_STATE, WRENCH, POSE = (
    'sensor_msgs/msg/JointState',
    'geometry_msgs/msg/WrenchStamped',
    'geometry_msgs/msg/PoseStamped',
)
MARKERS = 'visualization_msgs/msg/MarkerArray'
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
# The numbers of a message of a type by field and name.
READERS: dict[str, Callable[[Any], dict[tuple[str, str], float]]] = {
    JOINT_STATE: lambda message: {
        (field, name): number
        for field in ('position', 'velocity', 'effort')
        for name, number in zip(message.name, getattr(message, field))
    },
    WRENCH: lambda message: {
        ('wrench', f'{part}.{axis}'): getattr(getattr(message.wrench, part), axis)
        for part in ('force', 'torque')
        for axis in 'xyz'
    },
    POSE: lambda message: {
        (field, axis): getattr(part, axis)
        for field, part, axes in (
            ('point', message.pose.position, 'xyz'),
            ('quaternion', message.pose.orientation, 'xyzw'),
        )
        for axis in axes
    },
    MARKERS: lambda message: {
        (axis, marker.ns.rpartition('/')[2]): getattr(marker.pose.position, axis)
        for axis in 'xyz'
        for marker in message.markers
    },
    # Of the controller: the forces that it obeys, e.g. `table 10, board 5`, and no stamp.
    STATUS: lambda message: {
        ('effort', name): float(force)
        for value in message.values
        if value.key == 'forces'
        for each in value.value.split(', ')
        if each
        for name, force in [each.rsplit(' ', 1)]
    },
}


class BagColumns:
    """The messages of one topic of a type of `READERS`, in the order of the recording."""

    def __init__(self, type_name: str) -> None:
        self._type = type_name
        self._stamps, self._published = array('q'), array('Q')
        # Rows and numbers of the messages with the same fields and names: several nodes may share
        # a topic. A number takes 8 bytes.
        self._parts: dict[
            tuple[tuple[str, str], ...], tuple[array[int], array[float]]
        ] = {}

    def take(self, message: Any, published: int) -> None:
        """Add a message that was sent at a time [ns since the epoch], or nothing if it fails."""
        first = message.markers[0] if self._type == MARKERS else message
        content = READERS[self._type](message)
        numbers = array('d', content.values())
        stamps = array(
            'q',
            [
                published
                if self._type == STATUS
                else (
                    first.header.stamp.sec * 1_000_000_000 + first.header.stamp.nanosec
                )
            ],
        )
        rows, kept = self._parts.setdefault(tuple(content), (array('q'), array('d')))
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
        return tuple(
            dict.fromkeys(name for _, name in next(filter(None, self._parts), ()))
        )

    def values(self, field: str, names: Sequence[str] = ()) -> Matrix:
        """
        Return the numbers of a field, shape (m, k); NaN where a message has none of a name.

        `names` are the order of the columns, by default that of the first message.
        """
        names = names or [
            name for label, name in next(iter(self._parts)) if label == field
        ]
        result = np.full((len(self), len(names)), np.nan)
        for labels, (rows, numbers) in self._parts.items():
            block = np.asarray(numbers).reshape(len(rows), len(labels))
            for column, name in enumerate(names):
                if (field, name) in labels:
                    result[rows, column] = block[:, labels.index((field, name))]
        return result


@dataclass(frozen=True)
class BagMessages:
    """The messages of some topics of one graph."""

    by_topic: Mapping[str, BagColumns]  # by the name within the graph's namespace
    others: tuple[str, ...]  # names of all other topics
    cut_off: bool = False  # whether the recording ends in the middle
    unreadable: tuple[str, ...] = ()  # what could not be read of these topics, in words
    lost: tuple[str, ...] = ()  # what is not there of the recording, in words
    begin_lost: bool = False  # whether it began before its first message that is there
    end_lost: bool = False  # whether it went on after the last

    def __str__(self) -> str:
        """Return what else is there, for a line that says what is missing."""
        what = shorten(', '.join(self.others) or 'nothing', WIDTH, placeholder=' ...')
        cut_off = ', and a file that is cut off' if self.cut_off else ''
        return '; '.join((what + cut_off, *self.unreadable))


class Listed(NamedTuple):
    """What the metadata of a recording say that it holds."""

    files: tuple[str, ...]  # names, in the order of time
    messages: int


def read_metadata(folder: Path) -> Listed | None:
    """Return what the metadata of a recording list, None without any; ConfigError if damaged."""
    path = folder / METADATA
    if not path.is_file():
        return None
    try:
        content = read_yaml(path)['rosbag2_bagfile_information']
        return Listed(
            tuple(content['relative_file_paths']), int(content['message_count'])
        )
    except (KeyError, TypeError, ValueError):
        raise ConfigError(
            str(path), 'relative_file_paths and message_count of rosbag2'
        ) from None


def mcap_files(path: Path) -> list[Path]:
    """Return the MCAP files of a recording, or that file, also those compressed as a whole."""
    files = [path] if path.is_file() else sorted(path.glob('*.mcap*'))
    # rosbag2 counts bag_0, bag_1, ..., bag_10.
    return sorted(
        (file for file in files if re.search(r'\.mcap(\.zstd?)?$', file.name)),
        key=lambda file: [int(part) for part in re.findall(r'\d+', file.name)],
    )


def read_messages(
    path: Path,
    types: Mapping[str, str],
    namespace: str | None = None,
) -> BagMessages:
    """
    Read the messages of some topics of an MCAP file or a folder, as far as the files go.

    `types` has the type of each topic, one of `READERS`, by its name within the `namespace` of
    the graph. Raises ConfigError if there is no file, RunError if it holds several graphs and no
    namespace is given.
    """
    columns: dict[tuple[str, str], BagColumns] = {}  # by namespace and topic
    names: set[str] = set()  # full names of all topics
    unreadable: dict[str, str] = {}
    cut_off = last_cut_off = False
    count = 0  # of all messages
    suffix = re.compile(rf'(?:(.*)/)?({"|".join(map(re.escape, types))})')
    for record in _records(path):
        last_cut_off = record is None
        if record is None:
            cut_off = True
            continue
        count += 1
        schema, channel, message, decode = record
        name = channel.topic.strip('/')
        names.add(name)
        place = suffix.fullmatch(name)
        if place is None or name in unreadable:
            continue
        kind, key = types[place[2]], (place[1] or '', place[2])
        if schema is None or schema.name != kind:
            unreadable[name] = (
                f'expected {kind}, got {schema.name if schema else "no type"}'
            )
            continue
        taken = columns.get(key) or BagColumns(kind)
        try:
            taken.take(decode(), message.publish_time or message.log_time)
        except (
            Exception
        ) as error:  # whatever a message of another program makes of its decoder
            unreadable[name] = f'cannot be read: {error}'
        else:
            columns[key] = taken
    chosen = _namespace(path, [space for space, _ in columns], namespace)
    lost, begin_lost, end_lost = _compare_with_metadata(path, count, last_cut_off)
    return BagMessages(
        {topic: taken for (space, topic), taken in columns.items() if space == chosen},
        tuple(
            sorted(
                name
                for name in names
                if not (
                    (place := suffix.fullmatch(name))
                    and (place[1] or '', place[2]) in columns
                )
            )
        ),
        cut_off,
        tuple(f'{name}: {why}' for name, why in unreadable.items()),
        lost,
        begin_lost,
        end_lost,
    )


def _compare_with_metadata(
    path: Path,
    count: int,
    last_cut_off: bool,
) -> tuple[tuple[str, ...], bool, bool]:
    """
    Return what a recording of `count` messages lacks, in words, and whether its begin or its end.

    A file that has another name than the metadata say, or is cut off behind its last message, is
    no loss: every message is there.
    """
    try:
        listed = read_metadata(path) if path.is_dir() else None
    except ConfigError as error:
        return (str(error),), False, last_cut_off
    if listed is None:
        return (), False, last_cut_off
    if count >= listed.messages:
        return (), False, False
    there = {file.name.removesuffix('.zstd') for file in mcap_files(path)}
    absent = [name for name in listed.files if name.removesuffix('.zstd') not in there]
    lost = f'{METADATA} counts {listed.messages} messages, {count} are there'
    if absent:
        lost += f'; without {", ".join(absent)}'
    end_lost = last_cut_off or listed.files[-1] in absent
    return (lost,), listed.files[0] in absent, end_lost


def _records(path: Path) -> Iterator[tuple[Any, Any, Any, Callable[[], Any]] | None]:
    """Yield schema, channel, record and decoder of every message; None where a file is cut off."""
    files = mcap_files(path)
    if not files:
        hint = '`ros2 bag convert` makes MCAP of a database' * any(path.glob('*.db3*'))
        raise ConfigError(
            str(path), 'a run, an .mcap file or a folder with one', hint=hint
        )
    for file in files:
        try:
            stream: Any = file.open('rb')
        except OSError as error:
            raise RunError(f'{file}: {error.strerror}') from None
        with stream:
            # mcap's seeking reader would hold all messages before it hands out the first.
            reader = NonSeekingReader(
                stream
                if file.suffix == '.mcap'
                else BufferedReader(
                    zstandard.ZstdDecompressor().stream_reader(
                        stream, read_across_frames=True
                    )
                )
            )
            messages = reader.iter_messages(log_time_order=False)
            factory = (
                DecoderFactory()
            )  # each file of a recording numbers its types anew
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
    return decode(
        zstandard.decompress(data) if data[:4] == zstandard.FRAME_HEADER else data
    )


def _namespace(path: Path, spaces: Sequence[str], namespace: str | None) -> str:
    """Return the namespace of a graph: that asked for, or the only one."""
    # Grippers and the like have joint states of their own: one topic of several makes no graph.
    known = {space for space in spaces if spaces.count(space) > 1} or set(spaces)
    if namespace is None and len(known) > 1:
        names = ', '.join(f"'{space}'" for space in sorted(known))
        raise RunError(
            f'{path}: expected the topics of one graph, got the namespaces {names}; '
            '--namespace chooses one'
        )
    return known.pop() if namespace is None and known else (namespace or '').strip('/')
