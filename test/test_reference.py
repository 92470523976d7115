"""The pages of docs/reference say what the code declares: `make reference` writes them anew."""

import importlib.util

import pytest
from ros_graph import ROOT

spec = importlib.util.spec_from_file_location(
    'make_reference', ROOT / 'docs/make_reference.py'
)
reference = importlib.util.module_from_spec(spec)
spec.loader.exec_module(reference)


@pytest.mark.parametrize('name', reference.PAGES)
def test_page_is_up_to_date(name):
    written = (reference.FOLDER / name).read_text(encoding='utf-8')
    assert written == reference.PAGES[name](), 'run `make reference`'
