"""Tables and pages of studies: in files, in the terminal and in HTML."""

import json

from matplotlib.figure import Figure
from multicontact_control.experiment.study.measure import (
    largest,
    largest_known,
    middle,
    middle_known,
)
from multicontact_control.experiment.study.page import Page, Section, write_study_page
from multicontact_control.experiment.study.table import (
    Column,
    html_table,
    Line,
    Listing,
    LONGEST,
    write_table,
)
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

COLUMNS = (Column('estimator', number=False), Column('stable runs', 'stable'),
           Column('largest force [N]', 'F', spare=True))
LISTING = Listing(COLUMNS, [
    Line(['[fixed]', '1/2', '3.5'], False, 'AOB'), Line(['<lead>', '2/2', '2.5'], True, 'AOB'),
    Line(['none', '-', '1.5'])], caption='forces are true')


@pytest.mark.parametrize(('values', 'found'), [
    ([3.0, 1.0, 2.0], (3.0, 3.0, 2.0, 2.0)), ([3.0, None, 1.0], (None, 3.0, 3.0, 2.0)),
    ([None, 1.0, None], (None, 1.0, None, 1.0)), ([], (None,) * 4)])
def test_statistics_of_values_that_may_be_unknown(values, found):
    assert tuple(function(values) for function in (
        largest, largest_known, middle, middle_known)) == found


@pytest.mark.parametrize(('name', 'content', 'read'), [
    ('a.json', {'rows': [1, None]}, lambda path: json.loads(path.read_text())),
    ('a.yaml', {'b': 1, 'a': [2]}, lambda path: yaml.safe_load(path.read_text())),
    ('a.parquet', pa.table({'x': [1, 2]}), pq.read_table)])
def test_table_is_read_back_as_it_was_written(tmp_path, name, content, read):
    path = write_table(content, tmp_path / name)
    assert read(path) == content
    assert list(tmp_path.iterdir()) == [path]


def test_html_table_colours_verdicts_escapes_and_cuts_long_tables():
    text = html_table(LISTING)
    assert '<b class=no>1/2</b>' in text and '<b class=yes>2/2</b>' in text
    assert '&lt;lead&gt;' in text and text.count('<b>AOB</b>') == 1
    lines = [Line([str(i), '', '']) for i in range(LONGEST + 3)]
    text = html_table(Listing(COLUMNS, lines))
    assert f'<td>{LONGEST - 1}</td>' in text and f'<td>{LONGEST}</td>' not in text


def test_page_has_findings_before_figure_and_tables(tmp_path):
    page = Page('A <study>', [Section('Plant <p>', LISTING)], introduction=['Why & how'],
                warnings=['bad <w>'], findings=['good <f>'], figure=Figure())
    png, html = write_study_page(page, tmp_path / 'study')
    assert (png.name, html.name) == ('study.png', 'study.html')
    text = html.read_text()
    places = [text.index(part) for part in (
        '<h1>A &lt;study&gt;', 'Why &amp; how', 'bad &lt;w&gt;', 'good &lt;f&gt;', '<img',
        'Plant &lt;p&gt;', '&lt;lead&gt;')]
    assert places == sorted(places)
