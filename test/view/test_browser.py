"""The page in a browser: it loads without an error, and its elements steer."""

from __future__ import annotations

import os
import shutil
import threading
import time

from multicontact_control.experiment.scenario import resolve
from multicontact_control.view.browser import DRAWING, NAMES
from multicontact_control.view.embedded import EmbeddedSource
import pytest

pytest.importorskip('viser', reason='viser is not installed (extra [view])')
playwright = pytest.importorskip(
    'playwright.sync_api', reason='playwright is not installed (pip install playwright)')
CHROMIUM = next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = [
    pytest.mark.slow,
    # Chromium draws in software: beside other tests that takes longer than any patience.
    pytest.mark.skipif(not os.environ.get('MULTICONTACT_BROWSER'),
                       reason='MULTICONTACT_BROWSER is not set: `make browser` does'),
    pytest.mark.skipif(
        CHROMIUM is None, reason='Chromium is not installed (apt-get install chromium)')]

PATIENCE = 120.0  # s


def wait_for(condition, what):
    give_up = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < give_up, f'{what}: did not happen'
        time.sleep(0.05)


def test_page_loads_without_errors_and_a_slider_presses():
    from multicontact_control.view.page import Page

    page = Page(EmbeddedSource(resolve('paper', plant='rigid')), port=8481)
    stop = threading.Event()
    thread = threading.Thread(target=page.run, args=(stop,), daemon=True)
    thread.start()
    try:
        with playwright.sync_playwright() as driver:
            browser = driver.chromium.launch(
                executable_path=CHROMIUM, args=[*DRAWING, '--no-sandbox'])
            tab = browser.new_page(viewport={'width': 1280, 'height': 800})
            tab.set_default_timeout(1e3 * PATIENCE)  # ms; without graphics all is slow
            errors = []
            tab.on('console', lambda said: errors.append(said.text)
                   if said.type == 'error' else None)
            tab.on('pageerror', lambda error: errors.append(str(error)))
            tab.goto(page.url)
            tab.get_by_text('Press with 10 N').wait_for()
            wait_for(lambda: page.server.get_clients(), 'a connection')
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
            browser.close()
        # Without a browser it goes on, and presses as before.
        wait_for(lambda: page.newest.time > before + 1.0, 'time to pass')
        assert page.newest.commanded == {'table': 10.0, 'board': 10.0}
        assert errors == []
    finally:
        stop.set()
        thread.join()
        page.close()
