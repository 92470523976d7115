"""Chromium for the tests of pages, and what is to be seen in it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import os
import shutil
from typing import Any

import pytest

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable', 'chrome')
# Without graphics the processor draws; root is root of a container, without a sandbox.
SWITCHES = ['--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--no-sandbox']

# Of MULTICONTACT_BROWSER: without a browser tests fail instead of being skipped.
REQUIRED = 'required'
PATIENCE = 120.0  # s, for what a slow machine may make late
# Of a canvas or picture: the share of its pixels that is not white, and the colours of which there
# are at least 20 pixels, as in '#4c78a8', antialiased ones left out.
INK = """
element => {
  let context;
  if (element.tagName == 'CANVAS') context = element.getContext('2d');
  else {
    const copy = document.createElement('canvas');
    [copy.width, copy.height] = [element.naturalWidth, element.naturalHeight];
    context = copy.getContext('2d');
    context.fillStyle = '#fff';
    context.fillRect(0, 0, copy.width, copy.height);
    context.drawImage(element, 0, 0);
  }
  const {width, height} = context.canvas;
  const pixels = context.getImageData(0, 0, width, height).data, counts = new Map();
  let inked = 0;
  for (let i = 0; i < pixels.length; i += 4) {
    const [r, g, b, a] = pixels.subarray(i, i + 4);
    if (a == 0 || r + g + b == 3 * 255) continue;
    inked++;
    const colour = (r << 16) | (g << 8) | b;
    if (a == 255) counts.set(colour, (counts.get(colour) || 0) + 1);
  }
  return {share: inked / (width * height), colours: [...counts].filter(([, n]) => n >= 20).map(
    ([colour]) => '#' + colour.toString(16).padStart(6, '0'))};
}
"""


@contextmanager
def chromium_browser() -> Iterator[Any]:
    """Start Chromium without a window; without one skip, or fail if one is required."""
    path = next(filter(None, map(shutil.which, (os.environ.get('CHROMIUM', ''), *NAMES))), None)
    if path is None:
        give_up = pytest.fail if os.environ.get('MULTICONTACT_BROWSER') == REQUIRED else (
            pytest.skip)
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
        self.page.on('console', lambda line: self.problems.append(line.text)
                     if line.type == 'error' else None)
        self.page.on('pageerror', lambda error: self.problems.append(str(error)))
        self.page.on('requestfailed', lambda request: self.problems.append(
            f'{request.url}: {request.failure}'))
        self.page.on('request', lambda request: self.requests.append(request.url)
                     if request.url != url and not request.url.startswith(('data:', 'blob:'))
                     else None)
        self.page.goto(url)

    def ink(self, selector: str) -> list[dict[str, Any]]:
        """Return share and colours of every canvas or picture that a selector finds; see INK."""
        return [element.evaluate(INK) for element in self.page.query_selector_all(selector)]

    def cells(self, number: int) -> list[list[str]]:
        """Return the texts of a table of the page, row by row, its head first."""
        found: list[list[str]] = self.page.evaluate(
            'n => [...document.querySelectorAll("table:not(.u-legend)")[n].rows].map('
            'row => [...row.cells].map(cell => cell.innerText))', number)
        return found
