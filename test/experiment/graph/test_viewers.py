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
STEP = re.compile(r'\.(?P<field>\w+)(?:\[(?P<index>:|\d+)\])?'
                  r'(?:\{(?P<key>\w+)=="(?P<value>[^"]*)"\})?')


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
    assert information['message_count'] == sum(counts.values())
    described = {x['topic_metadata']['name']: x
                 for x in information['topics_with_message_count']}
    assert {name: x['message_count'] for name, x in described.items()} == counts
    with (bag / information['relative_file_paths'][0]).open('rb') as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary.statistics.message_count == sum(counts.values())
        by_topic = dict.fromkeys(counts, 0)
        for schema, channel, _, message in reader.iter_decoded_messages():
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


def resolve_path(path, recorded):
    """Return what a message path of Foxglove finds in the last message of its topic."""
    path = re.sub(r'\.@log10$', '', path)
    topic, _, rest = path.partition('.')
    found, place, rest = [recorded[topic][1][-1]], 0, f'.{rest}' if rest else ''
    while place < len(rest):
        step = STEP.match(rest, place)
        assert step, f'{path}: not understood from {rest[place:]}'
        place = step.end()
        found = [getattr(value, step['field']) for value in found]
        if step['index'] == ':':
            found = [item for value in found for item in value]
        elif step['index'] is not None:
            found = [value[int(step['index'])] for value in found]
        if step['key']:
            found = [value for value in found if getattr(value, step['key']) == step['value']]
    return found


def test_foxglove_shows_what_is_recorded(recorded, frames):
    layout = json.loads((config_dir() / 'foxglove_layout.json').read_text(encoding='utf-8'))
    configs, plotted = layout['configById'], set()
    for panel, config in configs.items():
        kind = panel.split('!')[0]
        if kind == '3D':
            assert config['followTf'] in frames
            assert {layer['frameId'] for layer in config['layers'].values()} <= frames
            for topic in config['topics']:
                connection, messages = recorded[topic]
                assert messages and connection.msgtype in DRAWN
        for path in config.get('paths', ()):
            value, = resolve_path(path['value'], recorded)
            assert isinstance(value, float if kind == 'Plot' else str), path
            plotted.add(re.split(r'[.\[]', path['value'])[0])
        if 'topicPath' in config:
            assert resolve_path(config['topicPath'], recorded)
        if 'topicToRender' in config:
            connection, messages = recorded[config['topicToRender']]
            assert connection.msgtype == 'diagnostic_msgs/msg/DiagnosticArray' and messages
    assert plotted == {f'/contact_forces/{name}' for name in (
        'measured', 'estimated', 'desired', 'noise_variance')} | {'/controller_node/status'}
    variances = [path['value'] for path in configs['Plot!variance']['paths']]
    assert all(value.endswith('.@log10') for value in variances)
