"""A recording as others see it: rosbags, mcap, and what RViz and Foxglove are told to show."""

from __future__ import annotations

import json
import re

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.run import GraphSpec, run_graph
from multicontact_control.experiment.scenario import resolve
from multicontact_control.nodes.topics import TOPICS
from multicontact_control.paths import config_dir
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores
import yaml

pytestmark = pytest.mark.ros

STORE = get_typestore(Stores.ROS2_JAZZY)
TICKS = 750  # both contacts hold by then

# What comes with RViz 2 and Foxglove, and the type of the topic that it shows.
DISPLAYS = {
    'RobotModel': 'std_msgs/msg/String', 'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'Wrench': 'geometry_msgs/msg/WrenchStamped', 'Pose': 'geometry_msgs/msg/PoseStamped',
    'Grid': None, 'TF': None}
DRAWN = {  # by the 3D panel
    'std_msgs/msg/String', 'visualization_msgs/msg/MarkerArray', 'geometry_msgs/msg/PoseStamped'}


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Return the folder of a recording of all topics of a graph."""
    folder = tmp_path_factory.mktemp('viewers')
    setup = resolve('quick', plant='rigid', duration=TICKS / 500.0)
    config = folder / 'config'
    with reserve_domain() as domain_id:
        result = run_graph(GraphSpec(
            out=folder, ticks=TICKS, rate=500.0, speed=0.7,
            reference_file=config / 'reference.yaml', domain_id=domain_id,
            parameter_files=setup.write(config)))
    return result.bag


@pytest.fixture(scope='module')
def recorded(bag):
    """Return the messages of each topic, and their connection."""
    with AnyReader([bag]) as reader:
        found = {x.topic: (x, []) for x in reader.connections}
        for connection, _, data in reader.messages():
            found[connection.topic][1].append(reader.deserialize(data, connection.msgtype))
    return found


@pytest.fixture(scope='module')
def frames(recorded):
    description = recorded['/robot_description'][1][-1].data
    return {'world', *re.findall(r'<link name="([^"]+)"', description)}


def test_recording_is_the_same_to_rosbags_and_mcap_and_in_its_metadata(bag, recorded):
    """Every message decodes with what the file itself says of its type."""
    counts = {topic: len(messages) for topic, (_, messages) in recorded.items()}
    assert set(counts) == {f'/{topic.name.lstrip("/")}' for topic in TOPICS}
    text = (bag / 'metadata.yaml').read_text(encoding='utf-8')
    information = yaml.safe_load(text)['rosbag2_bagfile_information']
    described = {x['topic_metadata']['name']: x
                 for x in information['topics_with_message_count']}
    assert {name: x['message_count'] for name, x in described.items()} == counts
    by_topic = dict.fromkeys(counts, 0)
    with (bag / information['relative_file_paths'][0]).open('rb') as stream:
        for schema, channel, _, message in make_reader(
                stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            by_topic[channel.topic] += 1
            assert type(message).__name__ == schema.name.rpartition('/')[2]
    assert by_topic == counts
    for name, (connection, _) in recorded.items():
        stated = described[name]['topic_metadata']
        assert stated['type'] == connection.msgtype
        assert stated['type_description_hash'] == STORE.hash_rihs01(connection.msgtype)


def test_rviz_shows_what_is_recorded(recorded, frames):
    rviz, shown = yaml.safe_load((config_dir() / 'multicontact.rviz').read_text()), set()
    manager = rviz['Visualization Manager']
    assert manager['Global Options']['Fixed Frame'] in frames
    for display in manager['Displays']:
        package, name = display['Class'].split('/')
        assert package == 'rviz_default_plugins' and name in DISPLAYS
        asked = display.get('Topic', display.get('Description Topic'))
        assert (asked is None) == (DISPLAYS[name] is None)
        if asked is None:
            continue
        connection, messages = recorded[asked['Value']]
        assert connection.msgtype == DISPLAYS[name] and messages
        shown.add(asked['Value'])
        offered = connection.ext.offered_qos_profiles[0]
        wanted = asked['Durability Policy'].upper().replace(' ', '_')
        assert wanted in ('VOLATILE', offered.durability.name)
        headers = [part.header for message in messages
                   for part in getattr(message, 'markers', [message]) if hasattr(part, 'header')]
        assert {header.frame_id for header in headers} <= frames
    assert shown >= {'/robot_description', '/ground_truth/surfaces', '/contact_markers'}


def test_foxglove_shows_what_is_recorded(recorded, frames):
    layout = json.loads((config_dir() / 'foxglove_layout.json').read_text(encoding='utf-8'))
    plotted = set()
    for panel, config in layout['configById'].items():
        if panel.startswith('3D'):
            assert {config['followTf']} | {
                layer['frameId'] for layer in config['layers'].values()} <= frames
            assert {recorded[topic][0].msgtype for topic in config['topics']} <= DRAWN
        for path in config.get('paths', ()):
            topic, _, field = path['value'].partition('.')
            message = recorded[topic.partition('[')[0]][1][-1]
            assert not field or hasattr(message, re.split(r'[.\[{]', field)[0]), path
            plotted.add(topic)
    assert plotted == {f'/contact_forces/{name}' for name in (
        'measured', 'estimated', 'desired', 'noise_variance')} | {'/controller_node/status'}
