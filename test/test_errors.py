from multicontact_control.errors import check_all, ConfigError
import pytest


def fail(field):
    raise ConfigError(field, 'a number', 'x', 'a.yaml')


def test_check_all_raises_one_line_for_each_value():
    assert check_all(lambda: None, lambda: 2) == [None, 2]
    with pytest.raises(ConfigError) as error:
        check_all(lambda: fail('a'), lambda: None, lambda: fail('b'), lambda: fail('a'))
    assert str(error.value) == (
        'a.yaml: a: expected a number, found x\na.yaml: b: expected a number, found x')
    assert (error.value.field, error.value.expected) == ('a', 'a number')
