import json

from multicontact_control.files import replacing, write_json
import pytest


def test_file_is_replaced_at_once_or_not_at_all(tmp_path):
    path = tmp_path / 'a.txt'
    path.write_text('old')
    with pytest.raises(KeyboardInterrupt), replacing(path) as partial:
        partial.write_text('ha')
        raise KeyboardInterrupt
    assert path.read_text() == 'old'
    write_json(path, {'x': [1.5, None]})
    with pytest.raises(ValueError):
        write_json(path, {'x': float('nan')})
    assert json.loads(path.read_text()) == {'x': [1.5, None]}
    assert list(tmp_path.iterdir()) == [path]
