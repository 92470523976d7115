"""
Who may look at the page and steer: only this machine, unless it is opened to a network.

On the loopback address pages of other sites, which the user's browser may have open, are kept out
by the names of host and origin. Elsewhere a token is asked for: the address that is printed holds
it, and the browser keeps it in a cookie.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import hmac
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
import ipaddress
import re
import secrets
from typing import Any
from urllib.parse import parse_qs, urlsplit

from multicontact_control.errors import RunError
import websockets.asyncio.server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

COOKIE, PARAMETER = 'multicontact_view', 'token'
LOCAL_NAMES = ('localhost', '127.0.0.1', '::1')


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address to listen on."""
    try:
        return host == 'localhost' or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class Access:
    """
    Lets requests in or not.

    Parameters
    ----------
    host
        Address that is listened on.
    token
        What has to be known to get in. If it is empty one is made up, for an address that others
        can reach.

    Attributes
    ----------
    token
        The token, empty if none is needed.

    """

    def __init__(self, host: str, token: str = '') -> None:
        self._local = is_loopback(host)
        self.token = token or ('' if self._local else secrets.token_urlsafe(16))

    def refusal(self, request: Request) -> Response | None:
        """Return the answer to a request that is not let in, None to one that is."""
        headers = request.headers
        host = headers.get('Host', '')
        name = urlsplit(f'//{host}').hostname or ''
        if self._local and name not in LOCAL_NAMES:
            return _answer(HTTPStatus.FORBIDDEN, f'not for the host name {name}')
        origin = headers.get('Origin')
        if origin is not None and urlsplit(origin).netloc != host:
            return _answer(HTTPStatus.FORBIDDEN, f'not for pages of {origin}')
        if not self.token:
            return None
        name = _cookie_name(host)
        if self._is_token(_cookie(headers.get('Cookie', ''), name)):
            return None
        given = parse_qs(urlsplit(request.path).query).get(PARAMETER, [''])[0]
        if not self._is_token(given):
            return _answer(HTTPStatus.UNAUTHORIZED, 'the address with its token is needed, as '
                           '`multicontact view` has printed it')
        return _answer(HTTPStatus.SEE_OTHER, '', {
            'Location': '/', 'Set-Cookie': f'{name}={self.token}; HttpOnly; SameSite=Strict'})

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self.token.encode())

    @contextmanager
    def guarding(self) -> Iterator[None]:
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
            guarded.append(True)
            return serve(*arguments, process_request=self._before(process_request), **options)

        module.serve = guarded_serve
        try:
            yield
        finally:
            module.serve = serve
        if not guarded:
            raise RunError('the page cannot be guarded: expected viser to listen by websockets')

    def _before(self, process: Callable[[Any, Request], Any] | None) -> Callable[..., Any]:
        def guard(connection: Any, request: Request) -> Any:
            refused = self.refusal(request)
            return refused or (process(connection, request) if process else None)
        return guard


def _cookie_name(host: str) -> str:
    """Return the cookie's name: browsers give those of a host to all pages on its ports."""
    port = re.search(r':(\d+)$', host)
    return f'{COOKIE}_{port[1]}' if port else COOKIE


def _cookie(text: str, name: str) -> str:
    try:
        cookie = SimpleCookie(text).get(name)
    except CookieError:
        return ''
    return cookie.value if cookie is not None else ''


def _answer(
    status: HTTPStatus, text: str, headers: dict[str, str] | None = None,
) -> Response:
    body = f'multicontact view: {text}\n'.encode() if text else b''
    return Response(status, status.phrase, Headers({
        'Content-Type': 'text/plain; charset=utf-8', 'Content-Length': str(len(body)),
        **(headers or {})}), body)
