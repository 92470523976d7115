import json
import re

from multicontact_control.experiment.claims import Claim
from multicontact_control.experiment.html_figure import figure, plot, script_json
from multicontact_control.experiment.html_parts import claims_table, page, table
from multicontact_control.experiment.panels import Panel, Trace
import numpy as np


def test_page_needs_no_other_file():
    panel = Panel('force [N]', [Trace('measured', np.arange(2.0))])
    text = page('Title <1>', figure('forces', [plot(panel, np.arange(2.0))]))
    assert 'Title &lt;1&gt;' in text and 'uPlot (v' in text
    assert 'Copyright (c) 2022 Leon Sorokin' in text
    assert 'uPlot (v' not in page('No figure', '<p>text</p>')
    assert not re.search(r'<script[^>]+src=|<link|<img[^>]+src="http', text)


def test_script_json_cannot_end_its_script():
    text = script_json({'a': '</script>'})
    assert '</' not in text and json.loads(text) == {'a': '</script>'}


def test_claims_table_says_what_does_not_hold_and_escapes():
    text = claims_table([Claim('a < b', '1', '2', False, 'why'), Claim('c', '1', '-', None, '')])
    assert 'does not hold' in text and 'not judged' in text and 'a &lt; b' in text


def test_table_sets_attributes_on_its_rows():
    assert '<tr id=x><td>1</td><td class=number>2</td></tr>' in table(
        ('a', 'b'), [('1', '2')], row_attributes=('id=x',))
