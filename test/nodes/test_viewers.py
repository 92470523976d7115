"""RViz and Foxglove are told to show topics that there are, as they are published."""

import json
import re

from multicontact_control.nodes.topics import TOPICS, WORLD_FRAME
from multicontact_control.paths import find_config_folder
import yaml

KNOWN = {f'/{topic.name.lstrip("/")}': topic for topic in TOPICS}
# What comes with RViz 2 and the type of the topic that it shows.
DISPLAYS = {
    'RobotModel': 'std_msgs/msg/String',
    'MarkerArray': 'visualization_msgs/msg/MarkerArray',
    'Wrench': 'geometry_msgs/msg/WrenchStamped',
    'Pose': 'geometry_msgs/msg/PoseStamped',
}
# By Foxglove's 3D panel.
DRAWN = set(DISPLAYS.values()) - {'geometry_msgs/msg/WrenchStamped'}


def test_rviz_shows_topics_as_they_are_published():
    text = (find_config_folder() / 'multicontact.rviz').read_text()
    manager = yaml.safe_load(text)['Visualization Manager']
    assert manager['Global Options']['Fixed Frame'] == WORLD_FRAME
    shown = set()
    for display in manager['Displays']:
        asked = display.get('Topic', display.get('Description Topic'))
        if asked is None:
            continue
        topic = KNOWN[asked['Value']]
        _, _, kind = display['Class'].rpartition('/')
        assert topic.type_name == DISPLAYS[kind]
        wanted = asked['Durability Policy'].upper().replace(' ', '_')
        assert wanted in ('VOLATILE', topic.profile.durability.name)
        shown.add(asked['Value'])
    assert shown >= {'/robot_description', '/ground_truth/surfaces', '/contact_markers'}


def test_foxglove_shows_fields_that_there_are():
    text = (find_config_folder() / 'foxglove_layout.json').read_text(encoding='utf-8')
    for panel, config in json.loads(text)['configById'].items():
        if panel.startswith('3D'):
            assert config['followTf'] == WORLD_FRAME
            for layer in config['layers'].values():
                assert layer['frameId'] == WORLD_FRAME
            for topic in config['topics']:
                assert KNOWN[topic].type_name in DRAWN
        for path in config.get('paths', ()):
            name, *fields = re.split(r'[.\[{]', path['value'])
            if fields:
                assert hasattr(KNOWN[name].message(), fields[0]), path
