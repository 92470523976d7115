"""Chromium for the tests of pages, and what is to be seen in it."""

from __future__ import annotations

from collections.abc import Iterator
import os
import shutil
from typing import Any

import pytest

NAMES = (
    'chromium',
    'chromium-browser',
    'google-chrome',
    'google-chrome-stable',
    'chrome',
)
# Without graphics the processor draws; root is root of a container, without a sandbox.
SWITCHES = ['--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--no-sandbox']

# Of MULTICONTACT_BROWSER: without a browser tests fail instead of being skipped.
REQUIRED = 'required'
PATIENCE = 120.0  # s, for what a slow machine may make late
# The share of a canvas that is drawn on.
INK = """
canvas => {
  const {width, height} = canvas;
  const pixels = canvas.getContext('2d').getImageData(0, 0, width, height).data;
  return pixels.filter((value, i) => i % 4 == 3 && value > 0).length / (width * height);
}
"""


@pytest.fixture(scope='module')
def chromium() -> Iterator[Any]:
    """
    Start Chromium for one file; without it skip, or fail if it is required.

    While playwright is there, no other event loop can run.
    """
    path = next(
        filter(None, map(shutil.which, (os.environ.get('CHROMIUM', ''), *NAMES))), None
    )
    if path is None:
        give_up = (
            pytest.fail
            if os.environ.get('MULTICONTACT_BROWSER') == REQUIRED
            else (pytest.skip)
        )
        give_up('no Chromium to test the pages in')
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=SWITCHES)
        try:
            yield browser
        finally:
            browser.close()


class Tab:
    """A page in the browser: its errors and failed requests, and what it asked for elsewhere."""

    def __init__(self, browser: Any, url: str, **options: Any) -> None:
        self.page = browser.new_page(**options)
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.problems: list[str] = []
        self.requests: list[str] = []
        self.page.on(
            'console',
            lambda line: (
                self.problems.append(line.text) if line.type == 'error' else None
            ),
        )
        self.page.on('pageerror', lambda error: self.problems.append(str(error)))
        self.page.on(
            'requestfailed',
            lambda request: self.problems.append(f'{request.url}: {request.failure}'),
        )
        self.page.on(
            'request',
            lambda request: (
                self.requests.append(request.url)
                if request.url != url and not request.url.startswith(('data:', 'blob:'))
                else None
            ),
        )
        self.page.goto(url)

    def ink(self, selector: str) -> list[float]:
        """Return the share of every canvas that a selector finds that is drawn on."""
        return [
            element.evaluate(INK) for element in self.page.query_selector_all(selector)
        ]
