"""Guests of the graph: one participant for all of a process, which leaves with the last."""

import os
from pathlib import Path
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

from multicontact_control.experiment.graph.domain import reserve_domain
from multicontact_control.nodes.link import GuestNode
import pytest

pytestmark = pytest.mark.ros


def test_guests_of_a_domain_are_one_participant_until_the_last_has_left(domain_id, monkeypatch):
    monkeypatch.delenv('ROS_DOMAIN_ID', raising=False)
    with reserve_domain() as own:
        check_guests(own, domain_id)


def check_guests(own, another):
    keeper = GuestNode('first', own)
    other, elsewhere = GuestNode('second', own), GuestNode('third', another)
    assert other.context is keeper.context is not elsewhere.context
    elsewhere.close()
    other.close()
    assert keeper.context.ok()
    assert 'first' in keeper.node.get_node_names()
    keeper.close()
    assert not keeper.context.ok()
    again = GuestNode('first', own)
    assert again.context.ok()
    assert again.context is not keeper.context
    again.close()


def test_short_cut_between_participants_of_a_process_is_off_unless_the_user_decides():
    """Fast DDS reads the file at the first participant; see `config/fastdds.xml`."""
    show = (
        'import os\nfrom multicontact_control.nodes.runtime import prepare_environment\n'
        'prepare_environment()\nprint(os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"])')
    environment = {name: value for name, value in os.environ.items()
                   if name != 'FASTRTPS_DEFAULT_PROFILES_FILE'}
    for chosen in ({}, {'FASTRTPS_DEFAULT_PROFILES_FILE': '/my/own.xml'}):
        said = subprocess.run([sys.executable, '-c', show], env={**environment, **chosen},
                              capture_output=True, text=True, check=True).stdout.split()[-1]
        if chosen:
            assert said == '/my/own.xml'
        else:
            file = ElementTree.fromstring(Path(said).read_text(encoding='utf-8'))
            assert [setting.text for setting in file.iter()
                    if setting.tag.endswith('intraprocess_delivery')] == ['OFF']
