"""Who is let in."""

from __future__ import annotations

from multicontact_control.view.access import Access, is_loopback
import pytest
from websockets.datastructures import Headers
from websockets.http11 import Request


def request(path='/', **headers):
    return Request(path, Headers({name.capitalize(): value for name, value in headers.items()}))


def test_only_loopback_addresses_are_this_machine():
    assert all(is_loopback(host) for host in ('127.0.0.1', 'localhost', '::1', '127.0.0.2'))
    assert not any(is_loopback(host) for host in ('0.0.0.0', '::', '192.168.1.4', 'robot'))


def test_on_this_machine_no_token_is_needed_but_other_sites_are_kept_out():
    access = Access('127.0.0.1')
    assert access.token == ''
    assert access.refusal(request(host='127.0.0.1:8080')) is None
    assert access.refusal(request(
        host='localhost:8080', origin='http://localhost:8080', upgrade='websocket')) is None
    for headers in ({'host': 'localhost:8080', 'origin': 'https://evil.example'},
                    {'host': 'localhost:8080', 'origin': 'http://localhost:9'},
                    {'host': 'localhost:8080', 'origin': 'null'},
                    {'host': 'rebound.example:8080'}, {}):
        assert access.refusal(request(**headers)).status_code == 403


@pytest.mark.parametrize('given', ['', 'own token'])
def test_where_others_reach_it_the_token_is_needed_once(given):
    access = Access('0.0.0.0', given)
    assert access.token == given if given else len(access.token) >= 20
    here = {'host': 'robot:8080'}
    assert access.refusal(request(**here)).status_code == 401
    assert access.refusal(request('/?token=wrong', **here)).status_code == 401
    assert access.refusal(request(
        cookie='multicontact_view_8080=wrong', **here)).status_code == 401
    assert access.refusal(request(cookie=';=;', **here)).status_code == 401
    if given:
        return
    answer = access.refusal(request(f'/?token={access.token}', **here))
    assert (answer.status_code, answer.headers['Location']) == (303, '/')
    cookie = answer.headers['Set-Cookie']
    assert 'HttpOnly' in cookie and 'SameSite=Strict' in cookie
    assert access.refusal(request(cookie=cookie.split(';')[0], **here)) is None
    assert access.refusal(request(
        cookie=cookie.split(';')[0], origin='http://evil.example', **here)).status_code == 403


def test_two_pages_on_one_host_do_not_lock_each_other_out():
    one, other = Access('0.0.0.0'), Access('0.0.0.0')
    cookies = [access.refusal(request(f'/?token={access.token}', host=host)).headers[
        'Set-Cookie'].split(';')[0] for access, host in (
            (one, 'robot:8080'), (other, 'robot:8081'))]
    assert len({cookie.split('=')[0] for cookie in cookies}) == 2
    for access, host in ((one, 'robot:8080'), (other, 'robot:8081')):
        assert access.refusal(request(host=host, cookie='; '.join(cookies))) is None


def test_tokens_differ_from_start_to_start():
    assert Access('0.0.0.0').token != Access('0.0.0.0').token
