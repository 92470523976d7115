"""The pages of docs/reference say what the code declares: `make reference` writes them anew."""

import importlib.util

from multicontact_control.config import ControllerConfig
from multicontact_control.nodes import topics
from multicontact_control.nodes.command_interface import SERVICES
from multicontact_control.nodes.parameters import NAMES_OF_MAPPINGS, parameter_specs
import pytest
from ros_graph import ROOT

spec = importlib.util.spec_from_file_location('make_reference', ROOT / 'docs/make_reference.py')
reference = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reference)


@pytest.mark.parametrize('name', reference.PAGES)
def test_page_is_up_to_date(name):
    written = (reference.FOLDER / name).read_text(encoding='utf-8')
    assert written == reference.PAGES[name](), 'run `make reference`'


def test_no_other_page_is_there():
    assert {path.name for path in reference.FOLDER.iterdir()} == {*reference.PAGES, 'python.md'}


def entries():
    found = {name: [entry for model in models for group in reference.groups(model)
                    for entry in group.entries] for name, models in reference.NODES.items()}
    return found | {name: [entry for group in reference.groups(model) for entry in group.entries]
                    for name, (_, model) in reference.FILES.items()}


def test_every_value_is_described_once_and_by_its_own_range():
    found = entries()
    for name, values in found.items():
        assert all(value.field.description for value in values), name
        assert len({value.name for value in values}) == len(values), name
    force = {value.name: value for value in found[topics.CONTROLLER]}['force.input_delay']
    assert (force.unit, force.limits, force.default) == ('s', '≥ 0', '`0.006`')


@pytest.mark.parametrize('node', [topics.CONTROLLER, topics.ESTIMATOR, topics.SIM,
                                  topics.RECORDER])
def test_names_are_those_that_a_node_declares(node):
    """The nodes walk the models on their own, with the contacts that they are given."""
    given = {NAMES_OF_MAPPINGS: ['NAME']}
    declared = {spec.name for model in reference.NODES[node]
                for spec in parameter_specs(model, given)}
    common = {spec.name for models in list(reference.NODES.values())[4:] for model in models
              for spec in parameter_specs(model, {})}
    assert {value.name for value in entries()[node]} == declared - common
    assert ControllerConfig in reference.NODES[topics.CONTROLLER]


def test_what_the_graph_offers_says_what_is_in_it():
    assert all(topic.content for topic in topics.TOPICS)
    assert all(service.content for service in SERVICES)
