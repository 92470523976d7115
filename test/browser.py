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
    asked_for = os.environ.get('CHROMIUM', '')
    found = [path for path in map(shutil.which, (asked_for, *NAMES)) if path]
    if not found:
        missing = 'no Chromium to test the pages in'
        if os.environ.get('MULTICONTACT_BROWSER') == REQUIRED:
            pytest.fail(missing)
        pytest.skip(missing)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found[0], args=SWITCHES)
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
        self._url = url
        self.page.on('console', self._on_console)
        self.page.on('pageerror', self._on_error)
        self.page.on('requestfailed', self._on_failed_request)
        self.page.on('request', self._on_request)
        self.page.goto(url)

    def _on_console(self, line: Any) -> None:
        if line.type == 'error':
            self.problems.append(line.text)

    def _on_error(self, error: Any) -> None:
        self.problems.append(str(error))

    def _on_failed_request(self, request: Any) -> None:
        self.problems.append(f'{request.url}: {request.failure}')

    def _on_request(self, request: Any) -> None:
        inline = request.url.startswith(('data:', 'blob:'))
        if request.url != self._url and not inline:
            self.requests.append(request.url)

    def ink(self, selector: str) -> list[float]:
        """Return the share of every canvas that a selector finds that is drawn on."""
        return [
            element.evaluate(INK) for element in self.page.query_selector_all(selector)
        ]
