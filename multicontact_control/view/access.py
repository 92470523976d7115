"""
Access to the page: only browsers on this machine that open the page itself may see and steer.

Pages of other sites in the user's browser can send requests to the loopback address too. Their
requests name another host or origin, by which they are refused.
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


def refuse_foreign_request(connection: Any, request: Request) -> Response | None:
    """
    Return the refusal of a request that is not from the page itself, None for one that is.

    A request is let in if its ``Host`` names this machine, and its ``Origin``, where a browser
    sends one, is that same host and port. Anything else is answered by 403 (forbidden).

    Parameters
    ----------
    connection
        Connection of ``websockets``, which words the response.
    request
        Request with its headers, before the connection becomes a websocket.

    """
    host = request.headers.get('Host', '')
    origin = request.headers.get('Origin')
    is_local = urlsplit(f'//{host}').hostname in LOCAL_NAMES
    is_same_origin = origin is None or urlsplit(origin).netloc == host
    if is_local and is_same_origin:
        return None
    response: Response = connection.respond(
        HTTPStatus.FORBIDDEN, f'multicontact view: not for {origin or host}\n'
    )
    return response


@contextmanager
def guard_viser_server() -> Iterator[None]:
    """
    Guard the server that viser starts in this context by `refuse_foreign_request`.

    viser has no option for this: the function of ``websockets`` that it serves by is replaced
    until the context ends.

    Raises
    ------
    RunError
        If viser has not served by that function, so that its server would be open to all.

    """
    module: Any = websockets.asyncio.server
    serve = module.serve
    is_guarded = False

    def serve_guarded(*arguments: Any, process_request: Any, **options: Any) -> Any:
        nonlocal is_guarded
        is_guarded = True

        def process_own_request(connection: Any, request: Request) -> Any:
            refusal = refuse_foreign_request(connection, request)
            return refusal or process_request(connection, request)

        return serve(*arguments, process_request=process_own_request, **options)

    module.serve = serve_guarded
    try:
        yield
    finally:
        module.serve = serve
    if not is_guarded:
        raise RunError(
            'page: expected viser to listen by websockets.asyncio, to be guarded'
        )
