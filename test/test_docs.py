"""What the documents name is there."""

import ast
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md'))]
PACKAGE = ROOT / 'multicontact_control'
FOLDERS = (ROOT, PACKAGE, PACKAGE / 'experiment', PACKAGE / 'experiment/study')


def defined_in(path):
    """Return the names of functions and classes of a file."""
    return {node.name for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
            if isinstance(node, (ast.FunctionDef, ast.ClassDef))}


def pairs():
    """Return what docs/derivation.md says: functions, each with the file it is in."""
    text = (ROOT / 'docs/derivation.md').read_text(encoding='utf-8')
    return re.findall(r'`(\w+)`(?: and `(\w+)`)? in `([\w/]+\.py)`', text)


def test_equations_are_where_the_derivation_says():
    assert len(pairs()) > 20
    for *names, path in pairs():
        found = defined_in(ROOT / 'multicontact_control' / path)
        assert set(filter(None, names)) <= found, path


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_files_that_a_document_names_are_there(document):
    text = document.read_text(encoding='utf-8')
    links = re.findall(r'\]\(([\w/.]+)\)', text)
    names = [name for name in re.findall(r'`([\w/]+\.(?:py|yaml|md))`', text) if '/' in name]
    for name in links:
        assert (document.parent / name).exists(), name
    for name in names:
        assert any((folder / name).exists() for folder in FOLDERS), name
