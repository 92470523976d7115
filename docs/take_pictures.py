"""
Take docs/view.png: the page of `multicontact view` while the simulated arm presses with 10 N.

Usage: ``python docs/take_pictures.py [PNG]``, in an environment with the extras [view,test] and a
Chromium (``CHROMIUM`` names another than those in PATH).
"""

from __future__ import annotations

import os
from pathlib import Path
import shutil
import subprocess
import sys

from playwright.sync_api import expect, Page, sync_playwright

PICTURE = Path(__file__).resolve().parent / 'view.png'
SIZE = {'width': 1500, 'height': 880}  # px
PATIENCE = 120e3  # ms
LOADED_FOR, SEEN_FOR = 10e3, 4e3  # ms, before the step, and of the step in the curves
NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
# Without graphics the processor draws; root is root of a container, without a sandbox.
SWITCHES = [
    '--use-angle=swiftshader',
    '--enable-unsafe-swiftshader',
    '--no-sandbox',
    '--hide-scrollbars',
]


def main() -> None:
    """Start the page, press, take the picture, end all."""
    picture = Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE
    chromium = next(
        filter(None, map(shutil.which, (os.environ.get('CHROMIUM', ''), *NAMES))), None
    )
    if chromium is None:
        sys.exit(
            'browser: expected Chromium (apt-get install chromium, or its path in CHROMIUM), '
            'got none'
        )
    view = subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.cli', 'view'],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        lines = iter(view.stdout or ())
        url = next((line.split()[-1] for line in lines if 'http' in line), None)
        if url is None:
            sys.exit('multicontact view has ended')
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=chromium, args=SWITCHES)
            page = browser.new_page(viewport=SIZE)
            page.set_default_timeout(PATIENCE)
            page.goto(url)
            expect(page.locator('td', has_text='free')).to_have_count(
                2, timeout=PATIENCE
            )
            page.wait_for_timeout(LOADED_FOR)
            press(page)
            page.wait_for_timeout(SEEN_FOR)
            page.screenshot(path=picture)
            browser.close()
    finally:
        view.terminate()
        view.wait()
    print(f'picture in {picture}')


def press(page: Page) -> None:
    """Press with 10 N on both contacts, and wait until they hold; close the notifications."""
    button = page.get_by_role('button', name='Press with 10 N')
    button.focus()
    button.press('Enter')
    expect(page.locator('td', has_text='holding')).to_have_count(2, timeout=PATIENCE)
    page.evaluate(
        'document.querySelectorAll("[class*=Notification-closeButton]")'
        '.forEach(button => button.click())'
    )


if __name__ == '__main__':
    main()
