"""Pages: what is in their HTML, how curves are decimated, and one of them in a browser."""

import json
import re

from browser import Tab
from multicontact_control.experiment import report
from multicontact_control.experiment.page import (
    envelope,
    figure,
    page,
    Panel,
    plot,
    script_json,
    Trace,
)
from multicontact_control.experiment.results import LoadedRun, summarise
import numpy as np
import pytest
from synthetic_run import disturbance_setup, paper_run

RANGES = ('() => [...document.querySelectorAll(".figure")].flatMap(place => place.plots.map('
          'plot => [plot.scales.x.min, plot.scales.x.max]))')


def test_page_needs_no_other_file():
    values = np.array([1e-3, 0.6, np.nan, np.inf, -1.0])
    made = [plot(Panel('R', [Trace('', values)], logarithmic=log), np.arange(5.0))
            for log in (False, True)]
    assert [each['data'][1] for each in made] == [
        [1e-3, 0.6, None, None, -1.0], [1e-3, 0.6, None, None, None]]
    text = page('Title <1>', figure('forces', made))
    assert 'Title &lt;1&gt;' in text and 'uPlot (v' in text
    assert 'Copyright (c) 2022 Leon Sorokin' in text
    assert 'uPlot (v' not in page('No figure', '<p>text</p>')
    assert '</' not in script_json('</script>') and json.loads(script_json('</a>')) == '</a>'
    assert not re.search(r'<script[^>]+src=|<link|<img[^>]+src="http', text)


def test_envelope_keeps_every_peak_and_its_place():
    time = np.arange(10001) / 500.0
    values = np.sin(time)
    values[4321], values[777] = 50.0, -40.0
    x, (y, clock), size = envelope(time, [values, time], 200)
    assert len(x) == len(y) <= 202 and size == 101
    assert (y.max(), y.min()) == (50.0, -40.0)
    assert (np.diff(x) >= 0.0).all() and (np.diff(clock) >= 0.0).all()
    assert abs(x[y.argmax()] - time[4321]) <= size / 500.0


@pytest.mark.browser
@pytest.mark.nightly
def test_report_in_a_browser(chromium, tmp_path, monkeypatch):
    monkeypatch.setattr(report, 'FORMATS', ('png',))
    setup = disturbance_setup('puma')
    data = paper_run(setup)
    summary = summarise(data, setup, mode='in_process', timing={'tick_us': {'p50': 61.5}})
    path = report.write_report([LoadedRun(tmp_path / 'run', setup, data, summary)], tmp_path)[0]
    opened = Tab(chromium, path.as_uri(), viewport={'width': 1240, 'height': 900})
    tab = opened.page
    tab.wait_for_function('() => [...document.querySelectorAll(".figure")].every('
                          'place => place.dataset.state == "drawn")')
    names = [place.get_attribute('id') for place in tab.query_selector_all('.figure')]
    assert names == [f'run0-{name}' for name in (
        'fig3_force_table', 'fig4_force_board', 'fig5_motion', 'fig6_noise_variance')]
    inks = opened.ink('.figure canvas')
    assert len(inks) == 7 and all(0.01 < ink < 0.99 for ink in inks)
    whole = tab.evaluate(RANGES)
    over = tab.locator('.u-over').first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    tab.mouse.move(box['x'] + 0.25 * box['width'], box['y'] + 50)
    tab.mouse.down()
    tab.mouse.move(box['x'] + 0.5 * box['width'], box['y'] + 50, steps=4)
    tab.mouse.up()
    tab.wait_for_function(  # a drag zooms all figures, a double click shows all again
        f'whole => ({RANGES})().every(([low, high], i) => high - low < 0.3 * whole[i][1])',
        arg=whole)
    over.dblclick()
    tab.wait_for_function(f'whole => JSON.stringify(({RANGES})()) == JSON.stringify(whole)',
                          arg=whole)
    assert (opened.problems, opened.requests) == ([], [])
