"""The messages of a recording as columns of numbers; needs no ROS installation."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
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
from multicontact_control.supervision.contacts import STATE_NAMES
import numpy as np
from numpy.typing import NDArray
import zstandard

LONGEST_LIST = 200  # characters of the topics that a line names
METADATA = 'metadata.yaml'  # of rosbag2: the files and the number of messages
MCAP_NAME = re.compile(r'.*\.mcap(\.zstd?)?')
NANOSECONDS = 1_000_000_000
JOINT_STATE = 'sensor_msgs/msg/JointState'
WRENCH = 'geometry_msgs/msg/WrenchStamped'
POSE = 'geometry_msgs/msg/PoseStamped'
MARKERS = 'visualization_msgs/msg/MarkerArray'
STATUS = 'diagnostic_msgs/msg/DiagnosticStatus'
IMAGES = ('sensor_msgs/msg/Image', 'sensor_msgs/msg/CompressedImage')

Numbers = dict[tuple[str, str], float]  # of one message, by field and name


def read_joint_state(message: Any) -> Numbers:
    """
    Return position, velocity and effort of each named joint, or contact, in SI units.

    A message may leave any of the three fields empty; contact forces come as the efforts of joints
    that are named like contacts.
    """
    numbers = {}
    for field in ('position', 'velocity', 'effort'):
        for name, number in zip(message.name, getattr(message, field)):
            numbers[field, name] = number
    return numbers


def read_wrench(message: Any) -> Numbers:
    """
    Return force [N] and torque [N m] as `wrench`, in the frame of the message's header.

    The names are `force.x` to `torque.z`, so that the columns of a series are force first.
    """
    numbers = {}
    for part in ('force', 'torque'):
        vector = getattr(message.wrench, part)
        for axis in 'xyz':
            numbers['wrench', f'{part}.{axis}'] = getattr(vector, axis)
    return numbers


def read_pose(message: Any) -> Numbers:
    """Return the position as `point` [m] and the orientation as `quaternion`, scalar last."""
    numbers = {}
    for axis in 'xyz':
        numbers['point', axis] = getattr(message.pose.position, axis)
    for axis in 'xyzw':
        numbers['quaternion', axis] = getattr(message.pose.orientation, axis)
    return numbers


def read_markers(message: Any) -> Numbers:
    """
    Return where each marker is, x, y and z [m], by the last part of its namespace.

    That part is the name of what the marker stands for, such as a contact; a marker without a
    namespace has the name ''.
    """
    numbers = {}
    for marker in message.markers:
        name = marker.ns.rpartition('/')[2]
        for axis in 'xyz':
            numbers[axis, name] = getattr(marker.pose.position, axis)
    return numbers


def read_status(message: Any) -> Numbers:
    """
    Return the forces that a controller obeys [N], and the state of each contact.

    Forces are in words such as `table 10, board 5`: what was accepted, where the command topic
    says what was asked for; there are none while no force is asked for. States are in words such
    as `table holding, board free`, and indices of `STATE_NAMES` as numbers.
    """
    numbers = {}
    for value in message.values:
        if value.key == 'forces' and value.value:
            for named_force in value.value.split(', '):
                name, force = named_force.rsplit(' ', 1)
                numbers['effort', name] = float(force)
        if value.key == 'contacts' and value.value:
            for named_state in value.value.split(', '):
                name, state = named_state.split(' ', 1)
                numbers['state', name] = float(STATE_NAMES.index(state))
    return numbers


READERS: dict[str, Callable[[Any], Numbers]] = {
    JOINT_STATE: read_joint_state,
    WRENCH: read_wrench,
    POSE: read_pose,
    MARKERS: read_markers,
    STATUS: read_status,
}


class BagColumns:
    """
    The messages of one topic as columns of numbers, in the order of the recording.

    The topic has one type of `READERS`. Numbers are kept in arrays of eight bytes each, so that
    an hour at 500 Hz fits in memory.
    """

    def __init__(self, type_name: str) -> None:
        self._type = type_name
        self._stamps = array('q')
        self._published = array('Q')
        # Rows and numbers of the messages with the same fields and names: several nodes may share
        # a topic.
        self._groups: dict[
            tuple[tuple[str, str], ...], tuple[array[int], array[float]]
        ] = {}

    def add_message(self, message: Any, published: int) -> None:
        """
        Add a message that was sent at a time [ns since the epoch].

        A message that cannot be read raises what its reader raises, and adds nothing.
        """
        content = READERS[self._type](message)
        numbers = array('d', content.values())
        stamp = array('q', [self._read_stamp(message, published)])
        rows, values = self._groups.setdefault(tuple(content), (array('q'), array('d')))
        rows.append(len(self))
        values.extend(numbers)
        self._stamps.extend(stamp)
        self._published.append(published)

    def _read_stamp(self, message: Any, published: int) -> int:
        """Return the stamp of a message [ns]: a status has none, markers have one each."""
        if self._type == STATUS:
            return published
        stamped = message.markers[0] if self._type == MARKERS else message
        stamp = stamped.header.stamp
        return stamp.sec * NANOSECONDS + stamp.nanosec

    def __len__(self) -> int:
        """Return the number of messages m that were added."""
        return len(self._stamps)

    @property
    def stamps(self) -> NDArray[np.int64]:
        """
        Stamps of the headers, shape (m,) [ns], in the order of the recording.

        Samples and their answers have the same stamp, by which series are aligned.
        """
        return np.array(self._stamps, dtype=np.int64)

    @property
    def published(self) -> NDArray[np.uint64]:
        """
        When the messages were sent, shape (m,) [ns since the epoch].

        A status has no stamp of its own: this time takes its place in `stamps`.
        """
        return np.array(self._published, dtype=np.uint64)

    @property
    def names(self) -> tuple[str, ...]:
        """
        Names in the first message that has any, each once.

        They are the joints or contacts of a recording whose configuration is not known; empty if
        no message names any.
        """
        for labels in self._groups:
            if labels:
                return tuple(dict.fromkeys(name for _, name in labels))
        return ()

    def values(self, field: str, names: Sequence[str] = ()) -> Matrix:
        """
        Return the numbers of a field, shape (m, k); NaN where a message has none of a name.

        `names` are the order of the columns, by default that of the first message. Messages may
        have their names in different orders, and only some of them.
        """
        if not names:
            first_labels = next(iter(self._groups))
            names = [name for label, name in first_labels if label == field]
        result = np.full((len(self), len(names)), np.nan)
        for labels, (rows, numbers) in self._groups.items():
            block = np.asarray(numbers).reshape(len(rows), len(labels))
            for column, name in enumerate(names):
                if (field, name) in labels:
                    result[rows, column] = block[:, labels.index((field, name))]
        return result


class RecordingLoss(NamedTuple):
    """
    What a recording lacks of the messages that its metadata count.

    A file may be absent, or cut off: then the run may have begun or ended elsewhere.
    """

    words: tuple[str, ...] = ()  # a remark for a person; none if nothing is lost
    at_begin: bool = False  # whether it began before its first message that is there
    at_end: bool = False  # whether it went on after the last


@dataclass(frozen=True)
class BagMessages:
    """The messages of some topics of one graph, and what the recording lacks of them."""

    by_topic: Mapping[str, BagColumns]  # by the name within the graph's namespace
    others: Sequence[str]  # full names of all other topics, sorted
    images: Sequence[str]  # those of them that are images
    cut_off: bool  # whether a file ends in the middle of a record
    unreadable: Sequence[str]  # what could not be read of these topics, in words
    loss: RecordingLoss

    def __str__(self) -> str:
        """
        Return what else is there, for a line that says what is missing.

        Topics that were not asked for, a file that is cut off, and what could not be read.
        """
        names = ', '.join(self.others) or 'nothing'
        there = shorten(names, LONGEST_LIST, placeholder=' ...')
        if self.cut_off:
            there += ', and a file that is cut off'
        return '; '.join([there, *self.unreadable])


class RecordingMetadata(NamedTuple):
    """
    What ``metadata.yaml`` of rosbag2 says that a recording holds.

    It is written at the recording's end, so that files or messages that it counts and that are not
    there have been lost since.
    """

    files: Sequence[str]  # names, in the order of time
    message_count: int


def read_metadata(folder: Path) -> RecordingMetadata | None:
    """
    Return what the metadata of a recording list.

    None without any, as of a recorder that was killed or of a bare MCAP file.

    Raises
    ------
    ConfigError
        If the file is there and lacks the files or the count.

    """
    path = folder / METADATA
    if not path.is_file():
        return None
    try:
        content = read_yaml(path)['rosbag2_bagfile_information']
        return RecordingMetadata(
            tuple(content['relative_file_paths']), int(content['message_count'])
        )
    except (KeyError, TypeError, ValueError):
        raise ConfigError(
            str(path), 'relative_file_paths and message_count of rosbag2'
        ) from None


def mcap_files(path: Path) -> list[Path]:
    """
    Return the MCAP files of a recording in the order of time, or of a file itself.

    Files that are compressed as a whole (``.mcap.zstd``) count. rosbag2 numbers its files bag_0,
    bag_1, ..., bag_10.
    """
    candidates = [path] if path.is_file() else path.glob('*')
    files = [file for file in candidates if MCAP_NAME.fullmatch(file.name)]
    return sorted(files, key=_numbers_in_name)


def _numbers_in_name(file: Path) -> tuple[list[int], str]:
    """Return what files are sorted by: bag_2 stands before bag_10."""
    return [int(digits) for digits in re.findall(r'\d+', file.name)], file.name


def read_messages(
    path: Path,
    types: Mapping[str, str],
    namespace: str | None = None,
) -> BagMessages:
    """
    Read the messages of some topics of an MCAP file or a folder, as far as the files go.

    Parameters
    ----------
    path
        Folder of a recording, or one file of it.
    types
        Type of each topic, one of `READERS`, by its name within the namespace of the graph.
    namespace
        Namespace of the graph; None for the only one that is recorded.

    Raises
    ------
    ConfigError
        If there is no MCAP file.
    RunError
        If a file cannot be opened, or several graphs were recorded and no namespace is given.

    """
    columns: dict[str, BagColumns] = {}  # by full name
    unreadable: dict[str, str] = {}  # why, by full name
    places: dict[str, tuple[str, str]] = {}  # namespace and topic, by full name
    images: list[str] = []
    count = 0
    cut_off = False
    last_cut_off = False
    for record in _read_records(path):
        last_cut_off = record is None
        if record is None:
            cut_off = True
            continue
        count += 1
        name = record.topic
        if name not in places:
            places[name] = _split_name(name, types)
            if record.type_name in IMAGES:
                images.append(name)
        _, topic = places[name]
        if not topic or name in unreadable:
            continue
        if record.type_name != types[topic]:
            unreadable[name] = f'expected {types[topic]}, got {record.type_name}'
            continue
        of_topic = columns.get(name)
        if of_topic is None:
            of_topic = BagColumns(types[topic])
        try:
            of_topic.add_message(record.decode(), record.published)
        except Exception as error:  # a message of another program may break any decoder
            unreadable[name] = f'cannot be read: {error}'
        else:
            columns[name] = of_topic
    by_graph: dict[str, dict[str, BagColumns]] = {}
    for name, of_topic in columns.items():
        space, topic = places[name]
        by_graph.setdefault(space, {})[topic] = of_topic
    if namespace is None:
        namespace = _only_namespace(path, by_graph)
    return BagMessages(
        by_topic=by_graph.get(namespace.strip('/'), {}),
        others=sorted(places.keys() - columns.keys()),
        images=sorted(images),
        cut_off=cut_off,
        unreadable=[f'{name}: {why}' for name, why in unreadable.items()],
        loss=_compare_with_metadata(path, count, last_cut_off),
    )


def _split_name(name: str, topics: Mapping[str, str]) -> tuple[str, str]:
    """Return namespace and topic of a full name, which is '' for a topic that is not asked for."""
    for topic in topics:
        namespace, found, rest = f'/{name}'.rpartition(f'/{topic}')
        if found and not rest:
            return namespace.strip('/'), topic
    return '', ''


def _only_namespace(path: Path, by_graph: Mapping[str, Mapping[str, object]]) -> str:
    """Return the namespace of the only graph; RunError if there are several."""
    # Grippers and the like have joint states of their own: one topic of several makes no graph.
    graphs = [space for space, topics in by_graph.items() if len(topics) > 1]
    known = sorted(graphs or by_graph)
    if len(known) > 1:
        names = ', '.join(f"'{space}'" for space in known)
        raise RunError(
            f'{path}: expected the topics of one graph, got the namespaces {names}; '
            '--namespace chooses one'
        )
    return known[0] if known else ''


def _compare_with_metadata(path: Path, count: int, last_cut_off: bool) -> RecordingLoss:
    """
    Return what a recording lacks of which `count` messages could be read.

    A file that has another name than the metadata say, or is cut off behind its last message, is
    no loss: every message is there.
    """
    try:
        listed = read_metadata(path)
    except ConfigError as error:
        return RecordingLoss((str(error),), at_end=last_cut_off)
    if listed is None:
        return RecordingLoss(at_end=last_cut_off)
    if count >= listed.message_count:
        return RecordingLoss()
    there = {file.name.removesuffix('.zstd') for file in mcap_files(path)}
    absent = [name for name in listed.files if name.removesuffix('.zstd') not in there]
    words = f'{METADATA} counts {listed.message_count} messages, {count} are there'
    if absent:
        words += f'; without {", ".join(absent)}'
    return RecordingLoss(
        (words,),
        at_begin=listed.files[0] in absent,
        at_end=last_cut_off or listed.files[-1] in absent,
    )


class _RecordedMessage(NamedTuple):
    """One message as it lies in a file."""

    schema: Any  # of mcap; None for a message without a type
    channel: Any
    message: Any
    factory: DecoderFactory  # of the file: each file numbers its types anew

    @property
    def topic(self) -> str:
        return str(self.channel.topic.strip('/'))

    @property
    def type_name(self) -> str:
        return self.schema.name if self.schema else 'no type'

    @property
    def published(self) -> int:
        """When it was sent, or else recorded [ns since the epoch]."""
        return int(self.message.publish_time or self.message.log_time)

    def decode(self) -> Any:
        """Return the message, also one that rosbag2 has compressed by itself."""
        encoding = self.channel.message_encoding
        decode = self.factory.decoder_for(encoding, self.schema)
        if decode is None:
            raise ValueError(f'{encoding} with {self.schema.encoding}')
        data = self.message.data
        if data[:4] == zstandard.FRAME_HEADER:
            data = zstandard.decompress(data)
        return decode(data)


def _read_records(path: Path) -> Iterator[_RecordedMessage | None]:
    """Yield every message; None where a file is cut off."""
    files = mcap_files(path)
    if not files:
        databases = any(path.glob('*.db3*'))
        raise ConfigError(
            str(path),
            'a run, an .mcap file or a folder with one',
            hint='`ros2 bag convert` makes MCAP of a database' if databases else '',
        )
    for file in files:
        try:
            stream: Any = file.open('rb')
        except OSError as error:
            raise RunError(f'{file}: {error.strerror}') from None
        with stream:
            if file.suffix != '.mcap':
                decompressor = zstandard.ZstdDecompressor()
                stream = BufferedReader(
                    decompressor.stream_reader(stream, read_across_frames=True)
                )
            # mcap's seeking reader would hold all messages before it hands out the first.
            reader = NonSeekingReader(stream)
            factory = DecoderFactory()
            try:
                for record in reader.iter_messages(log_time_order=False):
                    yield _RecordedMessage(*record, factory)
            except Exception:  # many kinds, of damaged lengths, names and checksums
                yield None
