import pytest

pytest.importorskip('websockets', reason='the extra [view] is not installed')
from multicontact_control.view.access import refusal  # noqa: E402, I100
from websockets.datastructures import Headers  # noqa: E402
from websockets.http11 import Request  # noqa: E402

HERE = 'localhost:8080'


@pytest.mark.parametrize(('headers', 'let_in'), [
    ({'Host': '127.0.0.1:8080'}, True), ({'Host': '[::1]:8080'}, True),
    ({'Host': HERE, 'Origin': 'http://localhost:8080', 'Upgrade': 'websocket'}, True),
    ({'Host': HERE, 'Origin': 'https://evil.example'}, False),
    ({'Host': HERE, 'Origin': 'http://localhost:9'}, False),
    ({'Host': HERE, 'Origin': 'null'}, False), ({'Host': 'rebound.example:8080'}, False),
    ({}, False)])
def test_refusal_keeps_other_sites_out(headers, let_in):
    refused = refusal(Request('/', Headers(headers)))
    assert refused is None if let_in else refused.status_code == 403
