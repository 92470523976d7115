"""Where Chromium is; as a program it prints that, or what is missing with exit code 1."""

from __future__ import annotations

import os
import shutil
import sys

from multicontact_control.errors import ConfigError

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable', 'chrome')
# Drawn by the processor: machines that take pictures have no graphics.
DRAWING = ('--use-angle=swiftshader', '--enable-unsafe-swiftshader')


def find_chromium() -> str:
    """Return the path of a Chromium; ConfigError without one."""
    for name in (os.environ.get('CHROMIUM', ''), *NAMES):
        found = shutil.which(name) if name else None
        if found:
            return found
    raise ConfigError('browser', 'Chromium (apt-get install chromium, or its path in CHROMIUM)',
                      'none')


def switches() -> list[str]:
    """Return what Chromium is started with to draw without graphics."""
    # Root is root of a container, where its sandbox does not work.
    return [*DRAWING, *(['--no-sandbox'] if os.geteuid() == 0 else [])]


if __name__ == '__main__':
    try:
        print(find_chromium())
    except ConfigError as error:
        sys.exit(str(error))
