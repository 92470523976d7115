"""From what is to be shown to a page that shows it, until it is ended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
import signal
import threading
import time
from types import FrameType
import webbrowser

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.experiment.scenario import Setup
from multicontact_control.view import source
from multicontact_control.view.page import HOST, Page, PORT
from multicontact_control.view.source import Source
import numpy as np

PRESS = 10.0  # N, for a picture
CLOSE = 1.0  # N
SEEN_FOR = 8.0  # s: what the browser draws comes in slowly, and curves show what was
PATIENCE = 30.0  # s


@dataclass(frozen=True)
class ViewOptions:
    """
    What to show, and to whom.

    Attributes
    ----------
    recording
        Folder of a run or bag to replay, None for none.
    graph, namespace, domain_id
        Whether to join a graph, and which.
    host, port, token
        Where to listen, and what has to be known to get in; see `Page`.
    open_browser
        Whether to open it.
    screenshot
        File of a picture to take, after which it ends; None for none.

    """

    recording: Path | None = None
    graph: bool = False
    namespace: str = ''
    domain_id: int | None = None
    host: str = HOST
    port: int = PORT
    token: str = ''
    open_browser: bool = False
    screenshot: Path | None = None


def run_view(setup: Setup, options: ViewOptions, say: Callable[[str], object]) -> str:
    """
    Show something on a page until a signal comes.

    Parameters
    ----------
    setup
        Of the simulation, or what is known of the graph or recording.
    options
        What to show, and to whom.
    say
        Called with lines for the user.

    Returns
    -------
    str
        Why there was nothing more to see, empty if the user has ended it.

    Raises
    ------
    MulticontactError
        If it cannot be shown.

    """
    if options.screenshot is not None:
        from multicontact_control.view.browser import find_chromium

        find_chromium()  # before anything is started
        if options.recording is not None or options.graph:
            raise ConfigError('screenshot', 'neither a recording nor --graph: it presses', 'both')
    page = Page(make_source(setup, options), options.host or HOST, options.port, options.token)
    try:
        if options.screenshot is not None:
            take_screenshot(page, options.screenshot)
            say(f'picture in {options.screenshot}')
            return ''
        with until_signal() as stop:
            say(f'{page.source.scene.title}: {page.url}')
            say('only this machine can reach it (--host opens it to a network)' if page.local else
                'others can reach it: whoever has the token in that address can steer')
            if options.open_browser:
                webbrowser.open(page.url)
            page.run(stop)
        return page.ended
    finally:
        page.close()


def make_source(setup: Setup, options: ViewOptions) -> Source:
    """Return what is to be shown."""
    if options.graph and options.recording is not None:
        raise ConfigError('graph', 'no recording with it', options.recording)
    if options.recording is not None:
        from multicontact_control.view.replay import load_replay

        return load_replay(options.recording, setup)
    if options.graph:
        try:
            from multicontact_control.view.graph import GraphSource
        except ImportError as error:
            raise RunError(f'ROS 2 (rclpy) cannot be loaded: {error}; install the extra [ros] or '
                           'source a ROS 2 Jazzy') from None

        return GraphSource(setup, namespace=options.namespace, domain_id=options.domain_id)
    from multicontact_control.view.embedded import EmbeddedSource

    ensure_compiled()
    return EmbeddedSource(setup)


@contextmanager
def until_signal() -> Iterator[threading.Event]:
    """Set an event when the user, or the system, wants an end."""
    stop = threading.Event()

    def end(_number: int, _frame: FrameType | None) -> None:
        stop.set()

    before = [(number, signal.signal(number, end)) for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        yield stop
    finally:
        for number, handler in before:
            signal.signal(number, handler)


def take_screenshot(page: Page, path: Path) -> None:
    """
    Press with the tool, and take a picture of the page once all contacts hold.

    Raises
    ------
    RunError
        If they do not hold in time, or there is no picture.

    """
    from multicontact_control.view.browser import Browser

    names = page.source.scene.config.contact_names
    stop = threading.Event()
    with Browser() as browser:
        browser.load(page.url)
        shower = threading.Thread(target=page.run, args=(stop,), daemon=True)
        shower.start()
        try:
            wait(lambda: page.newest is not None, page, 'samples')
            page.commander.give(None, source.FORCES, **dict.fromkeys(names, PRESS))
            wait(lambda: holds(page), page, f'{" and ".join(names)} to hold {PRESS:g} N')
            wait(lambda: bool(page.server.get_clients()), page, 'the browser')
            time.sleep(0.5 * SEEN_FOR)
            browser.dismiss()
            time.sleep(0.5 * SEEN_FOR)
            browser.screenshot(path)
        finally:
            stop.set()
            shower.join()


def holds(page: Page) -> bool:
    """Return whether all contacts are held with the force of a picture."""
    newest = page.newest
    if newest is None:
        return False
    leaders = list(page.source.scene.config.leaders)
    return set(newest.states) == {'holding'} and bool(
        (np.abs(newest.measured[leaders] - PRESS) < CLOSE).all())


def wait(condition: Callable[[], bool], page: Page, what: str) -> None:
    """Wait for something; RunError if it does not come, or the source ends."""
    give_up = time.monotonic() + PATIENCE
    while not condition():
        if page.ended:
            raise RunError(page.ended)
        if time.monotonic() > give_up:
            raise RunError(f'waited {PATIENCE:g} s for {what}')
        time.sleep(0.05)
