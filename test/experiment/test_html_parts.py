import json
import re

from multicontact_control.experiment.claims import Claim
from multicontact_control.experiment.html_parts import (
    claims_table,
    corners,
    envelope,
    figure,
    page,
    script_json,
    table,
)
import numpy as np


def test_envelope_keeps_every_peak_and_the_order_in_time():
    time = np.arange(10000) / 500.0
    values = np.sin(time)
    values[4321] = 50.0
    values[777] = -40.0
    x, y = envelope(time, values, 100)
    assert len(x) == len(y) <= 200
    assert max(y) == 50.0 and min(y) == -40.0
    assert x == sorted(x)
    assert x[y.index(50.0)] == time[4321]


def test_envelope_leaves_out_what_is_not_finite():
    values = np.array([np.nan, 1.0, np.inf, 2.0])
    assert envelope(np.arange(4.0), values, 10) == ([1.0, 3.0], [1.0, 2.0])
    assert envelope(np.arange(2.0), np.full(2, np.nan), 10) == ([], [])


def test_corners_keep_both_sides_of_every_step():
    values = np.array([2.0, 2.0, 2.0, 10.0, 10.0, 10.0])
    assert corners(np.arange(6.0), values) == ([0.0, 2.0, 3.0, 5.0], [2.0, 2.0, 10.0, 10.0])


def test_page_needs_no_other_file():
    text = page('Title <1>', figure('forces', [{'y': [1, 2]}], {}))
    assert 'Title &lt;1&gt;' in text and 'plotly.js v' in text
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
