"""What the documents name is there."""

import functools
from pathlib import Path
import re
import subprocess
import sys

from multicontact_control.supervision import causes
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / 'docs').rglob('*.md'))
DOCUMENTS = [
    ROOT / 'README.md',
    ROOT / 'CONTRIBUTING.md',
    ROOT / 'CHANGELOG.md',
    ROOT / 'SECURITY.md',
    *PAGES,
]
PACKAGE = ROOT / 'multicontact_control'
FOLDERS = (ROOT, PACKAGE, PACKAGE / 'study')


def test_equations_are_in_the_functions_that_the_derivation_names():
    text = (ROOT / 'docs/derivation.md').read_text(encoding='utf-8')
    rows = re.findall(r'`(\w+)`(?: and `(\w+)`)? in `([\w/]+\.py)`', text)
    assert len(rows) > 20
    for name, second, path in rows:
        source = (PACKAGE / path).read_text(encoding='utf-8')
        defined = re.findall(r'^ *(?:def|class) (\w+)', source, re.MULTILINE)
        assert {name, second} <= {*defined, ''}, path


CAUSES = re.compile(r'^\| `(\w+)` \| .* \| `?([\w.]+)`? \|$', re.MULTILINE)
# Of an exception or a collision, what is added is not in the table.
SUPERVISED_CAUSES = {*causes.CHECKS.values()} - {'collision', 'internal', 'law'}


def test_interface_says_which_reaction_each_cause_leads_to():
    """What an exception or the joint of a collision adds to a cause is not in the table."""
    text = (ROOT / 'docs/interface.md').read_text(encoding='utf-8')
    section = text.partition('## Reactions')[2].partition('## Nodes')[0]
    reactions = dict(CAUSES.findall(section))
    assert SUPERVISED_CAUSES < {*reactions}
    of_inputs = {
        cause.partition('_')[2] for cause in reactions if cause.startswith(causes.PARTS)
    }
    assert {*causes.PROBLEMS} <= of_inputs
    assert reactions.pop('collision_JOINT') == 'collision.reaction'
    assert reactions.pop('internal_ERROR') == causes.FLOAT
    for cause, reaction in reactions.items():
        bit = causes.BITS.get(cause, causes.LAW)
        number = causes.choose_severest_reaction(bit, causes.TO_NONE)
        assert causes.SEVERITY[number] == reaction, cause


def prose(path):
    """Return a document without its blocks of code."""
    text = path.read_text(encoding='utf-8')
    return re.sub(r'^```.*?^```$', '', text, flags=re.MULTILINE | re.DOTALL)


@functools.cache
def anchors(path):
    """Return the anchors of a document's headings, as GitHub and MyST make them."""
    found = set()
    for heading in re.findall(r'^#+ (.*)$', prose(path), re.MULTILINE):
        words = re.sub(r'[^\w\- ]', '', heading.lower())
        found.add(words.replace(' ', '-'))
    return found


def broken_links(path):
    """Return the links of a document that lead nowhere: to no file, or to no heading of it."""
    text = re.sub(r'`[^`]*`', '', prose(path))
    for link in re.findall(r'\[[^\]]*\]\(([^)\s]+)\)', text):
        name, _, anchor = link.partition('#')
        if name.startswith(('http:', 'https:')):
            continue
        target = path.parent / name if name else path
        if not target.exists() or (anchor and anchor not in anchors(target)):
            yield link


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_links_and_files_of_a_document_are_there(document):
    assert list(broken_links(document)) == []
    if document.name != 'CHANGELOG.md':
        text = document.read_text(encoding='utf-8')
        for name in re.findall(r'`([\w/]+/[\w/]+\.(?:py|yaml|md))`', text):
            assert any((folder / name).exists() for folder in FOLDERS), name


def test_python_page_lists_what_its_html_documents():
    """So that the page says the same where no HTML is made of it."""
    page = ROOT / 'docs/api.md'
    text = page.read_text(encoding='utf-8')
    documented = re.findall(r'^\.\. auto\w+:: \S+\.(\w+)$', text, re.MULTILINE)
    assert len(documented) > 20
    for name in documented:
        assert f'`{name}`' in prose(page), name


@pytest.mark.nightly
def test_documents_become_html_without_a_warning(tmp_path):
    """As `make docs` makes it."""
    pytest.importorskip('furo', reason='the extra [docs] is not installed')
    options = ['--fail-on-warning', '--keep-going', '--quiet']
    made = subprocess.run(
        [sys.executable, '-m', 'sphinx', *options, ROOT / 'docs', tmp_path],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert made.returncode == 0, made.stderr
    page = (tmp_path / 'api.html').read_text(encoding='utf-8')
    assert 'multicontact_control.client.MultiContactClient.set_forces' in page
