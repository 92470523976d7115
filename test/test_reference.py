"""The pages of docs/reference say what the code declares: `make reference` writes them anew."""

import importlib.util

from multicontact_control.nodes import topics
from multicontact_control.nodes.controller_topics import SERVICES
import pytest
from ros_graph import ROOT

spec = importlib.util.spec_from_file_location('make_reference', ROOT / 'docs/make_reference.py')
reference = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reference)


@pytest.mark.parametrize('name', reference.PAGES)
def test_page_is_up_to_date(name):
    written = (reference.FOLDER / name).read_text(encoding='utf-8')
    assert written == reference.PAGES[name](), 'run `make reference`'


def test_pages_are_all_there_are():
    assert {path.name for path in reference.FOLDER.iterdir()} == {*reference.PAGES, 'python.md'}


def test_every_parameter_topic_and_service_is_described():
    files = {name: (model,) for name, (_, model) in reference.FILES.items()}
    models = {**reference.NODES, **files}
    for name, each in models.items():
        entries = [entry for model in each for group in reference.groups(model)
                   for entry in group.entries]
        assert all(entry.field.description for entry in entries), name
        assert len({entry.name for entry in entries}) == len(entries), name
    assert all(each.content for each in topics.TOPICS)
    assert all(content for _, content in SERVICES.values())
