"""The page in a browser: it loads without an error, and its elements steer."""

from __future__ import annotations

import threading
import time

from browser import PATIENCE, Tab
from multicontact_control.experiment.scenario import resolve
from multicontact_control.view.embedded import EmbeddedSource
import pytest

pytest.importorskip('viser', reason='viser is not installed (extra [view])')
pytestmark = [pytest.mark.slow, pytest.mark.webgl]

SMALL = {'width': 520, 'height': 640}  # px: the processor draws all of them
# Twice a second is enough for a scene at which nobody looks.
SELDOM = """
const draw = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = callback => setTimeout(() => draw(callback), 500);
"""


def wait_for(condition, what):
    give_up = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < give_up, f'{what}: did not happen'
        time.sleep(0.05)


@pytest.fixture
def page():
    """Show a simulation on a page."""
    from multicontact_control.view.page import Page

    page = Page(EmbeddedSource(resolve('paper', plant='rigid')), port=8481)
    stop = threading.Event()
    thread = threading.Thread(target=page.run, args=(stop,), daemon=True)
    thread.start()
    yield page
    stop.set()
    thread.join()
    page.close()


def test_page_loads_without_errors_and_a_slider_presses(page, chromium):
    context = chromium.new_context(viewport=SMALL)
    context.add_init_script(SELDOM)
    opened = Tab(context, page.url)
    tab = opened.page
    tab.get_by_text('Press with 10 N').wait_for()
    wait_for(lambda: page.server.get_clients() and page.newest, 'a connection and samples')
    slider = tab.get_by_role('slider').first
    slider.focus()
    tab.keyboard.press('End')  # one key each: a slow browser makes two of two
    wait_for(lambda: page.newest.commanded['table'] == 30.0, 'the largest force')
    tab.keyboard.press('Home')
    wait_for(lambda: page.newest.commanded['table'] == 0.0, 'letting go')
    tab.keyboard.press('ArrowRight')
    refused = tab.get_by_text('refused: force on table')
    refused.wait_for()
    assert '0 or 3 to 30 N, found 0.5 N' in refused.inner_text()
    tab.get_by_role('button', name='Press with 10 N').click()
    wait_for(lambda: page.newest.commanded['table'] == 10.0, 'the button')
    before = page.newest.time
    context.close()
    # Without a browser it goes on, and presses as before.
    wait_for(lambda: page.newest.time > before + 1.0, 'time to pass')
    assert page.newest.commanded == {'table': 10.0, 'board': 10.0}
    assert opened.problems == []
