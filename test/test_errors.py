from multicontact_control.errors import check_all, ConfigError
import pytest


def fail(field):
    raise ConfigError(field, 'a number', 'x', 'a.yaml')


def test_all_that_is_wrong_is_said_a_line_for_each():
    with pytest.raises(ConfigError) as error:
        check_all(lambda: fail('a'), lambda: None, lambda: fail('b'))
    assert str(error.value) == (
        'a.yaml: a: expected a number, found x\na.yaml: b: expected a number, found x')
    assert (error.value.field, error.value.expected) == ('a', 'a number')


def test_single_error_is_left_as_it_is_and_none_is_fine():
    assert check_all(lambda: None, lambda: 2) == [None, 2]
    with pytest.raises(ConfigError, match='^a.yaml: a: expected a number, found x$'):
        check_all(lambda: None, lambda: fail('a'))
