import json

from multicontact_control.files import file_name, replacing, write_json
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


def test_any_name_makes_one_file_of_the_folder(tmp_path):
    for name in ('edge/along', '../up', 'a b:c*?"<>|\\d\n', 'Fläche_1.5-x'):
        (tmp_path / file_name(name)).write_text('')
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        '.._up', 'Fläche_1.5-x', 'a_b_c_______d_', 'edge_along']
