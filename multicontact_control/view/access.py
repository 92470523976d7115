"""
Who may look at the page and steer: browsers on this machine that ask for it themselves.

The page listens on the loopback address. Pages of other sites, which the user's browser may have
open, reach that address too: they are kept out by the names of host and origin.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from multicontact_control.errors import RunError
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

LOCAL_NAMES = ('localhost', '127.0.0.1', '::1')


def refusal(request: Request) -> Response | None:
    """Return the answer to a request that is not let in, None to one that is."""
    host = request.headers.get('Host', '')
    name = urlsplit(f'//{host}').hostname or ''
    origin = request.headers.get('Origin')
    if name not in LOCAL_NAMES:
        text = f'not for the host name {name}'
    elif origin is not None and urlsplit(origin).netloc != host:
        text = f'not for pages of {origin}'
    else:
        return None
    body = f'multicontact view: {text}\n'.encode()
    return Response(HTTPStatus.FORBIDDEN, HTTPStatus.FORBIDDEN.phrase, Headers({
        'Content-Type': 'text/plain; charset=utf-8', 'Content-Length': str(len(body))}), body)


@contextmanager
def guarding() -> Iterator[None]:
    """
    Guard the server that is started inside.

    viser has no say in who connects, but listens by `websockets.asyncio.server.serve`.

    Raises
    ------
    RunError
        If no server was started, which would be unguarded.

    """
    module: Any = websockets.asyncio.server
    serve, guarded = module.serve, []

    def guarded_serve(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def guard(connection: Any, request: Request) -> Any:
            return refusal(request) or (
                process_request(connection, request) if process_request else None)

        guarded.append(True)
        return serve(*arguments, process_request=guard, **options)

    module.serve = guarded_serve
    try:
        yield
    finally:
        module.serve = serve
    if not guarded:
        raise RunError('the page cannot be guarded: expected viser to listen by websockets')
