"""From what is to be shown to a page that shows it, until it is ended."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import signal
import threading
import webbrowser

from multicontact_control.errors import ConfigError, RunError
from multicontact_control.experiment.compilation import ensure_compiled
from multicontact_control.experiment.scenario import Setup
from multicontact_control.view.source import Source


def run_view(
    setup: Setup, say: Callable[[str], object], *, recording: Path | None = None,
    graph: bool = False, namespace: str | None = None, domain_id: int | None = None,
    port: int = 8080, open_browser: bool = False,
) -> str:
    """
    Show a simulation, a graph or a recording on a page until a signal comes.

    Parameters
    ----------
    setup
        Of the simulation, or what is known of the graph or recording.
    say
        Called with lines for the user.
    recording, graph, namespace, domain_id
        What to show; see `make_source`.
    port
        To listen on; the next one that is free.
    open_browser
        Whether to open it.

    Returns
    -------
    str
        Why there was nothing more to see, empty if the user has ended it.

    Raises
    ------
    MulticontactError
        If it cannot be shown.

    """
    try:
        from multicontact_control.view.page import Page
    except ImportError as error:
        raise ConfigError('view', "viser, by pip install 'multicontact_control[view]'",
                          f'none that can be loaded ({error})') from None
    page = Page(make_source(setup, recording, graph, namespace, domain_id), port)
    stop = threading.Event()
    before = [(number, signal.signal(number, lambda *_: stop.set()))
              for number in (signal.SIGINT, signal.SIGTERM)]
    try:
        say(f'{page.source.scene.title}: {page.url}')
        say('only this machine can reach it')
        if open_browser:
            webbrowser.open(page.url)
        page.run(stop)
        return page.ended
    finally:
        for number, handler in before:
            signal.signal(number, handler)
        page.close()


def make_source(
    setup: Setup, recording: Path | None = None, graph: bool = False,
    namespace: str | None = None, domain_id: int | None = None,
) -> Source:
    """
    Return what is to be shown.

    Parameters
    ----------
    setup
        Of the simulation, or what is known of the graph or recording.
    recording
        Folder of a run or bag to replay, None for none.
    graph, domain_id
        Whether to join a graph, and where.
    namespace
        Of that graph, or of the one in the recording; None for none, or the only one there.

    Raises
    ------
    MulticontactError
        If it cannot be shown.

    """
    if graph and recording is not None:
        raise ConfigError('graph', 'no recording with it', recording)
    if recording is not None:
        from multicontact_control.view.replay import load_replay

        try:
            return load_replay(recording, setup, namespace)
        except RunError as error:
            raise ConfigError('recording', 'one that can be read', f'none: {error}') from None
    if graph:
        from multicontact_control.view.graph import GraphSource

        return GraphSource(setup, namespace=namespace or '', domain_id=domain_id)
    from multicontact_control.view.embedded import EmbeddedSource

    ensure_compiled()
    return EmbeddedSource(setup)
