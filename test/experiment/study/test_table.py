"""Tables of studies, in files, in the terminal and on a page."""

import io
import json

from multicontact_control.experiment.study.table import (
    Column,
    html_table,
    Line,
    Listing,
    LONGEST,
    short_names,
    terminal_table,
    write_table,
)
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console
import yaml

COLUMNS = (Column('estimator', number=False), Column('stable runs', 'stable'),
           Column('largest force [N]', 'F', spare=True))
LISTING = Listing(COLUMNS, [
    Line(['[fixed]', '1/2', '3.5'], False, 'AOB'), Line(['<lead>', '2/2', '2.5'], True, 'AOB'),
    Line(['none', '-', '1.5'])], caption='forces are true')


def shown(listing, width):
    text = io.StringIO()
    Console(file=text, width=width).print(terminal_table('Plant [x]', listing, width))
    return text.getvalue()


@pytest.mark.parametrize(('name', 'content', 'read'), [
    ('a.json', {'rows': [1, None]}, lambda path: json.loads(path.read_text())),
    ('a.yaml', {'b': 1, 'a': [2]}, lambda path: yaml.safe_load(path.read_text())),
    ('a.csv', [{'run': 0, 'wall': '0.5'}, {'run': 1, 'wall': '1.5'}],
     lambda path: [dict(zip(('run', 'wall'), (int(line[0]), line[2:])))
                   for line in path.read_text().splitlines()[1:]]),
    ('a.parquet', pa.table({'x': [1, 2]}), pq.read_table)])
def test_table_is_read_back_as_it_was_written(tmp_path, name, content, read):
    path = write_table(content, tmp_path / name)
    assert read(path) == content
    assert list(tmp_path.iterdir()) == [path]


def test_terminal_has_groups_and_leaves_out_what_it_has_no_room_for():
    wide, narrow = shown(LISTING, 120), shown(LISTING, 60)
    for text in (wide, narrow):
        assert text.count('AOB') == 1
        assert 'Plant [x]' in text and '[fixed]' in text and 'forces are true' in text
        assert 'stable' in text and 'stable runs' not in text
    assert '3.5' in wide and '3.5' not in narrow


def test_page_colours_the_verdict_and_escapes_the_rest():
    text = html_table(LISTING)
    assert '<b class=no>1/2</b>' in text and '<b class=yes>2/2</b>' in text
    assert '&lt;lead&gt;' in text and 'largest force [N]' in text
    assert text.count('<b>AOB</b>') == 1


def test_page_says_how_much_of_a_long_table_is_left_out():
    lines = [Line([str(i), '', '']) for i in range(LONGEST + 3)]
    text = html_table(Listing(COLUMNS, lines))
    assert '3 more lines are left out' in text
    assert f'<td>{LONGEST - 1}</td>' in text and f'<td>{LONGEST}</td>' not in text


def test_short_names_still_tell_columns_apart():
    assert short_names(['plant', 'a.b.c', 'a.d.c', 'e.f']) == ['plant', 'b.c', 'd.c', 'f']
    assert short_names(['runs/a/first', 'runs/b/first', 'runs/c'], '/') == [
        'a/first', 'b/first', 'c']
