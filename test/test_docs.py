"""What the documents name is there."""

import ast
import functools
from pathlib import Path
import re
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / 'docs').rglob('*.md'))
DOCUMENTS = [
    ROOT / 'README.md',
    ROOT / 'CONTRIBUTING.md',
    ROOT / 'CHANGELOG.md',
    *PAGES,
]
PACKAGE = ROOT / 'multicontact_control'
FOLDERS = (ROOT, PACKAGE, PACKAGE / 'study')


@pytest.mark.parametrize(
    ('page', 'pattern'),
    [
        ('derivation.md', r'`(\w+)`(?: and `(\w+)`)? in `([\w/]+\.py)`'),
        ('architecture.md', r'^\| `(?:(\w+)\.)?(\w+)` \| `(\w[\w/]*\.py)` \|'),
    ],
)
def test_functions_are_where_a_page_says(page, pattern):
    text = (ROOT / 'docs' / page).read_text(encoding='utf-8')
    rows = re.findall(pattern, text, re.MULTILINE)
    assert len(rows) > 20
    for *names, path in rows:
        tree = ast.parse((PACKAGE / path).read_text(encoding='utf-8'))
        defined = {
            node.name
            for node in ast.walk(tree)
            if isinstance(node, (ast.FunctionDef, ast.ClassDef))
        }
        assert set(filter(None, names)) <= defined, path


def prose(path):
    """Return a document without its blocks of code."""
    return re.sub(
        r'^```.*?^```$',
        '',
        path.read_text(encoding='utf-8'),
        flags=re.MULTILINE | re.DOTALL,
    )


@functools.cache
def anchors(path):
    """Return the anchors of a document's headings, as GitHub and MyST make them."""
    return {
        re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-')
        for heading in re.findall(r'^#+ (.*)$', prose(path), re.MULTILINE)
    }


def broken_links(path):
    """Return the links of a document that lead nowhere: to no file, or to no heading of it."""
    for link in re.findall(
        r'\[[^\]]*\]\(([^)\s]+)\)', re.sub(r'`[^`]*`', '', prose(path))
    ):
        name, _, anchor = link.partition('#')
        target = path.parent / name if name else path
        if not name.startswith(('http:', 'https:')) and not (
            target.exists() and (not anchor or anchor in anchors(target))
        ):
            yield link


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_links_and_files_of_a_document_are_there(document):
    assert list(broken_links(document)) == []
    if document.name != 'CHANGELOG.md':
        text = document.read_text(encoding='utf-8')
        for name in re.findall(r'`([\w/]+/[\w/]+\.(?:py|yaml|md))`', text):
            assert any((folder / name).exists() for folder in FOLDERS), name


@pytest.mark.nightly
def test_documents_become_html_without_a_warning(tmp_path):
    """As `make docs` makes it."""
    pytest.importorskip('furo', reason='the extra [docs] is not installed')
    made = subprocess.run(
        [
            sys.executable,
            '-m',
            'sphinx',
            '--fail-on-warning',
            '--keep-going',
            '--quiet',
            str(ROOT / 'docs'),
            str(tmp_path),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert made.returncode == 0, made.stderr
    page = (tmp_path / 'reference/python.html').read_text(encoding='utf-8')
    assert 'multicontact_control.client.MultiContactClient.set_forces' in page
