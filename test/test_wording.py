from multicontact_control.wording import counted
import pytest


@pytest.mark.parametrize(('number', 'words'), [(0, '0 runs'), (1, '1 run'), (2, '2 runs')])
def test_one_is_not_several(number, words):
    assert counted(number, 'runs') == words
