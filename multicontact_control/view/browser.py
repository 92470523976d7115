"""A Chromium without a window, to take a picture of a page."""

from __future__ import annotations

import base64
import itertools
import json
from pathlib import Path
import shutil
import subprocess
import tempfile
import time
from typing import Any
from urllib.request import urlopen

from multicontact_control.errors import RunError
from multicontact_control.view.chromium import find_chromium, switches
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

START_TIMEOUT, ANSWER_TIMEOUT = 30.0, 120.0  # s
LARGEST = 1 << 26  # bytes
NICENESS = '5'


class Browser:
    """
    A Chromium in a process of its own, spoken to by its own protocol; ends with the block.

    Parameters
    ----------
    size
        Of its window, width and height [px].

    """

    def __init__(self, size: tuple[int, int]) -> None:
        self._size = size
        self._folder = tempfile.TemporaryDirectory(
            prefix='multicontact_view_', ignore_cleanup_errors=True)
        nice = shutil.which('nice')
        arguments = [
            # What is drawn may come late, the ticks of what is shown may not.
            *([nice, '-n', NICENESS] if nice else []), find_chromium(),
            '--headless=new', '--remote-debugging-port=0', '--no-first-run',
            '--hide-scrollbars', '--disable-dev-shm-usage', '--mute-audio', *switches(),
            f'--window-size={size[0]},{size[1]}', f'--user-data-dir={self._folder.name}']
        self._process = subprocess.Popen(
            [*arguments, 'about:blank'], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL)
        self._numbers = itertools.count(1)
        try:
            self._connection = self._connect()
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> Browser:
        """Return the browser itself."""
        return self

    def __exit__(self, *_error: object) -> None:
        """End it."""
        self._connection.close()
        self._end()

    def _end(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(5.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()

    def _connect(self) -> ClientConnection:
        told = Path(self._folder.name) / 'DevToolsActivePort'
        give_up = time.monotonic() + START_TIMEOUT
        while time.monotonic() < give_up and self._process.poll() is None:
            lines = told.read_text(encoding='utf-8').split() if told.is_file() else []
            if len(lines) >= 2:
                with urlopen(f'http://127.0.0.1:{lines[0]}/json/list', timeout=10.0) as answer:
                    pages = [each for each in json.load(answer) if each['type'] == 'page']
                if pages:
                    return connect(pages[0]['webSocketDebuggerUrl'], max_size=LARGEST)
            time.sleep(0.05)
        raise RunError(f'screenshot: Chromium did not start within {START_TIMEOUT:g} s')

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Ask the browser for something; RunError if there is no good answer."""
        number = next(self._numbers)
        try:
            self._connection.send(json.dumps(
                {'id': number, 'method': method, 'params': parameters}))
            while True:
                answer = json.loads(self._connection.recv(ANSWER_TIMEOUT))
                if answer.get('id') == number:
                    break
        except (OSError, TimeoutError, WebSocketException) as error:
            raise RunError(f'screenshot: Chromium does not answer: {error}') from None
        if 'error' in answer:
            raise RunError(f'screenshot: {method}: {answer["error"]["message"]}')
        result: dict[str, Any] = answer['result']
        return result

    def load(self, url: str) -> None:
        """Load a page."""
        self._call('Emulation.setDeviceMetricsOverride', width=self._size[0],
                   height=self._size[1], deviceScaleFactor=1, mobile=False)
        self._call('Page.navigate', url=url)

    def dismiss(self) -> None:
        """Close the notifications: that this browser draws without graphics is known."""
        self._call('Runtime.evaluate', expression=(
            'document.querySelectorAll("[class*=Notification-closeButton]")'
            '.forEach(button => button.click())'))

    def screenshot(self, path: Path) -> None:
        """Write what is seen into a PNG file; RunError if that is not possible."""
        picture = base64.b64decode(self._call('Page.captureScreenshot', format='png')['data'])
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(picture)
        except OSError as error:
            raise RunError(f'screenshot: {path} cannot be written ({error.strerror})') from None
