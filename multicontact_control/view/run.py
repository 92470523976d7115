"""From what is to be shown to a page that shows it, until it is ended."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
import signal
import socket
import threading
import time
from types import FrameType
import webbrowser

from multicontact_control.errors import ConfigError, importing_ros, RunError
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.experiment.scenario import Setup
from multicontact_control.view import source
from multicontact_control.view.page import HOST, Page, PORT
from multicontact_control.view.source import Source
import numpy as np

PRESS = 10.0  # N, for a picture; half of it before, so that the curves show a step
SIZE = (1600, 900)  # px, of a picture
LEAST_SIZE, LARGEST_SIZE = 400, 8000  # px
CLOSE = 1.0  # N
DRAWN_FOR, SEEN_FOR = 20.0, 4.0  # s: what the browser draws comes in slowly; after the step
PATIENCE = 30.0  # s


@dataclass(frozen=True)
class ViewOptions:
    """
    What to show, and to whom.

    Attributes
    ----------
    recording
        Folder of a run or bag to replay, None for none.
    graph, domain_id
        Whether to join a graph, and where.
    namespace
        Of that graph, or of the one in the recording; None for none, or the only one there.
    host, port, token
        Where to listen, and what has to be known to get in; see `Page`.
    open_browser
        Whether to open it.
    screenshot, size
        File of a picture to take, after which it ends, None for none; its width and height [px].

    """

    recording: Path | None = None
    graph: bool = False
    namespace: str | None = None
    domain_id: int | None = None
    host: str = HOST
    port: int = PORT
    token: str = ''
    open_browser: bool = False
    screenshot: Path | None = None
    size: tuple[int, int] = SIZE


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
        from multicontact_control.view.chromium import find_chromium

        find_chromium()  # before anything is started
        if options.recording is not None or options.graph:
            raise ConfigError('screenshot', 'neither a recording nor --graph: it presses', 'both')
    host = options.host or HOST
    check_address(host)
    page = Page(make_source(setup, options), host, options.port, options.token)
    try:
        if options.screenshot is not None:
            take_screenshot(page, options.screenshot, options.size)
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


def check_address(host: str) -> None:
    """Check that this machine can listen on an address; ConfigError if not."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, 0, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
        with socket.socket(family, kind, protocol) as listener:
            listener.bind(address)
    except OSError as error:
        raise ConfigError('host', 'an address of this machine', f'{host} ({error.strerror})'
                          ) from None


def read_size(text: str) -> tuple[int, int]:
    """Return width and height of a picture [px], given as WIDTHxHEIGHT; ConfigError if not."""
    parts = text.split('x')
    if len(parts) == 2 and all(part.isdecimal() for part in parts):
        width, height = map(int, parts)
        if LEAST_SIZE <= min(width, height) and max(width, height) <= LARGEST_SIZE:
            return width, height
    raise ConfigError(
        'size', f'WIDTHxHEIGHT of {LEAST_SIZE} to {LARGEST_SIZE} pixels', f"'{text}'")


def make_source(setup: Setup, options: ViewOptions) -> Source:
    """Return what is to be shown."""
    if options.graph and options.recording is not None:
        raise ConfigError('graph', 'no recording with it', options.recording)
    if options.recording is not None:
        from multicontact_control.view.replay import load_replay

        try:
            return load_replay(options.recording, setup, options.namespace)
        except RunError as error:
            raise ConfigError('recording', 'one that can be read', f'none: {error}') from None
    if options.graph:
        with importing_ros():
            from multicontact_control.view.graph import GraphSource

        return GraphSource(
            setup, namespace=options.namespace or '', domain_id=options.domain_id)
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


def take_screenshot(page: Page, path: Path, size: tuple[int, int] = SIZE) -> None:
    """
    Press with the tool, and take a picture of the page once all contacts hold.

    Raises
    ------
    RunError
        If they do not hold in time, or there is no picture.

    """
    from multicontact_control.view.browser import Browser

    stop = threading.Event()
    with Browser(size) as browser:
        browser.load(page.url)
        shower = threading.Thread(target=page.run, args=(stop,), daemon=True)
        shower.start()
        try:
            wait(lambda: page.newest is not None, page, 'samples')
            page.curves.look_back('30 s')
            press(page, 0.5 * PRESS)
            wait(lambda: bool(page.server.get_clients()), page, 'the browser')
            time.sleep(DRAWN_FOR)
            browser.dismiss()
            press(page, PRESS)
            time.sleep(SEEN_FOR)
            browser.screenshot(path)
        finally:
            stop.set()
            shower.join()


def press(page: Page, force: float) -> None:
    """Press with all contacts, and wait until they hold with that force [N]."""
    names = page.source.scene.config.contact_names
    page.commander.give(None, source.FORCES, **dict.fromkeys(names, force))
    wait(lambda: holds(page, force), page, f'{" and ".join(names)} to hold {force:g} N')


def holds(page: Page, force: float) -> bool:
    """Return whether all contacts are held with a force [N]."""
    newest = page.newest
    if newest is None:
        return False
    leaders = list(page.source.scene.config.leaders)
    return set(newest.states) == {'holding'} and bool(
        (np.abs(newest.measured[leaders] - force) < CLOSE).all())


def wait(condition: Callable[[], bool], page: Page, what: str) -> None:
    """Wait for something; RunError if it does not come, or the source ends."""
    give_up = time.monotonic() + PATIENCE
    while not condition():
        if page.ended:
            raise RunError(page.ended)
        if time.monotonic() > give_up:
            raise RunError(f'waited {PATIENCE:g} s for {what}')
        time.sleep(0.05)
