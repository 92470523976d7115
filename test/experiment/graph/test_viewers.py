"""A recording as others see it: what RViz and Foxglove are told to show is in it."""

from __future__ import annotations

import json
import re

from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.experiment.graph.run import GraphSpec, run_graph
from multicontact_control.experiment.scenario import resolve
from multicontact_control.nodes.topics import TOPICS
from multicontact_control.paths import config_dir
import pytest
from rosbags.highlevel import AnyReader
import yaml

pytestmark = pytest.mark.ros

TICKS = 750  # both contacts hold by then
# What comes with RViz 2 and the type of the topic that it shows.
DISPLAYS = {
    'RobotModel': 'std_msgs/msg/String', 'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'Wrench': 'geometry_msgs/msg/WrenchStamped', 'Pose': 'geometry_msgs/msg/PoseStamped',
    'Grid': None, 'TF': None}
DRAWN = {  # by the 3D panel of Foxglove
    'std_msgs/msg/String', 'visualization_msgs/msg/MarkerArray', 'geometry_msgs/msg/PoseStamped'}


@pytest.fixture(scope='module')
def recorded(tmp_path_factory):
    """Record all topics of a graph; return the connection and the messages of each."""
    folder = tmp_path_factory.mktemp('viewers')
    setup = resolve('quick', plant='rigid', duration=TICKS / 500.0)
    config = folder / 'config'
    with reserve_domain() as domain_id:
        result = run_graph(GraphSpec(
            out=folder, ticks=TICKS, rate=500.0, speed=0.7,
            reference_file=config / 'reference.yaml', domain_id=domain_id,
            parameter_files=setup.write(config)))
    with AnyReader([result.bag]) as reader:
        found = {x.topic: (x, []) for x in reader.connections}
        for connection, _, data in reader.messages():
            found[connection.topic][1].append(reader.deserialize(data, connection.msgtype))
    assert set(found) == {f'/{topic.name.lstrip("/")}' for topic in TOPICS}
    return found


@pytest.fixture(scope='module')
def frames(recorded):
    description = recorded['/robot_description'][1][-1].data
    return {'world', *re.findall(r'<link name="([^"]+)"', description)}


def test_rviz_shows_what_is_recorded(recorded, frames):
    rviz, shown = yaml.safe_load((config_dir() / 'multicontact.rviz').read_text()), set()
    manager = rviz['Visualization Manager']
    assert manager['Global Options']['Fixed Frame'] in frames
    for display in manager['Displays']:
        kind = DISPLAYS[display['Class'].removeprefix('rviz_default_plugins/')]
        asked = display.get('Topic', display.get('Description Topic'))
        assert (asked is None) == (kind is None)
        if asked is None:
            continue
        connection, messages = recorded[asked['Value']]
        assert connection.msgtype == kind and messages
        shown.add(asked['Value'])
        wanted = asked['Durability Policy'].upper().replace(' ', '_')
        assert wanted in ('VOLATILE', connection.ext.offered_qos_profiles[0].durability.name)
        assert {part.header.frame_id for message in messages
                for part in getattr(message, 'markers', [message])
                if hasattr(part, 'header')} <= frames
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
