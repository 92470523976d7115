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
LOADING_TIME = 10e3  # ms, before the step
SHOWN_TIME = 4e3  # ms, of the step in the curves
NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
# Without graphics the processor draws; root is root of a container, without a sandbox.
SWITCHES = [
    '--use-angle=swiftshader',
    '--enable-unsafe-swiftshader',
    '--no-sandbox',
    '--hide-scrollbars',
]


def find_chromium() -> str:
    """
    Return the path of a Chromium, that of ``CHROMIUM`` first; without one, end.

    The program ends with the command that installs it.
    """
    for name in (os.environ.get('CHROMIUM', ''), *NAMES):
        path = shutil.which(name)
        if path is not None:
            return path
    sys.exit(
        'browser: expected Chromium (apt-get install chromium, or its path in CHROMIUM), '
        'got none'
    )


def main() -> None:
    """
    Start the page and its graph, press on both contacts, take the picture, end all.

    The first argument is the picture's path; by default it replaces that of the documents. The
    view is ended also if a step fails.
    """
    picture = PICTURE
    if len(sys.argv) > 1:
        picture = Path(sys.argv[1])
    chromium = find_chromium()
    view = subprocess.Popen(
        [sys.executable, '-m', 'multicontact_control.cli', 'view'],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        url = read_address(view)
        with sync_playwright() as driver:
            browser = driver.chromium.launch(executable_path=chromium, args=SWITCHES)
            page = browser.new_page(viewport=SIZE)
            page.set_default_timeout(PATIENCE)
            page.goto(url)
            expect(page.locator('td', has_text='free')).to_have_count(
                2, timeout=PATIENCE
            )
            page.wait_for_timeout(LOADING_TIME)
            press_contacts(page)
            page.wait_for_timeout(SHOWN_TIME)
            page.screenshot(path=picture)
            browser.close()
    finally:
        view.terminate()
        view.wait()
    print(f'picture in {picture}')


def read_address(view: subprocess.Popen[str]) -> str:
    """
    Return the address of the page, which `multicontact view` prints when the graph is up.

    End this program if the command ends without it.
    """
    if view.stdout is not None:
        for line in view.stdout:
            if 'http' in line:
                return line.split()[-1]
    sys.exit('multicontact view has ended')


def press_contacts(page: Page) -> None:
    """
    Press with 10 N on both contacts, and wait until they hold.

    The notifications that the page shows meanwhile are closed, so that none is in the picture.
    """
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
