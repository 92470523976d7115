"""
Who may look at the page and steer: browsers on this machine that ask for it themselves.

Pages of other sites, which the user's browser may have open, reach the loopback address too: they
are kept out by the names of host and origin.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from multicontact_control.errors import RunError
import websockets.asyncio.server
from websockets.http11 import Request, Response

LOCAL_NAMES = ('localhost', '127.0.0.1', '::1')


def refusal(connection: Any, request: Request) -> Response | None:
    """Return the answer to a request that is not let in, None to one that is."""
    host, origin = request.headers.get('Host', ''), request.headers.get('Origin')
    if urlsplit(f'//{host}').hostname in LOCAL_NAMES and (
        origin is None or urlsplit(origin).netloc == host
    ):
        return None
    response: Response = connection.respond(
        HTTPStatus.FORBIDDEN, f'multicontact view: not for {origin or host}\n'
    )
    return response


@contextmanager
def guarding() -> Iterator[None]:
    """Guard the server that viser starts inside; RunError if it listens in another way."""
    module: Any = websockets.asyncio.server
    serve, guarded = module.serve, []

    def guarded_serve(*arguments: Any, process_request: Any, **options: Any) -> Any:
        guarded.append(True)
        return serve(
            *arguments,
            **options,
            process_request=lambda connection, request: (
                refusal(connection, request) or process_request(connection, request)
            ),
        )

    module.serve = guarded_serve
    try:
        yield
    finally:
        module.serve = serve
    if not guarded:
        raise RunError(
            'page: expected viser to listen by websockets.asyncio, to be guarded'
        )
