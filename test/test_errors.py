from multicontact_control.errors import check_all, ConfigError, importing_ros, RunError
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


@pytest.mark.parametrize(('others', 'ways'), [
    ((), 'install the extra [ros] or source a ROS 2 Jazzy'),
    (('simulate',), 'install the extra [ros], source a ROS 2 Jazzy or simulate')])
def test_ros_that_is_not_there_is_said_in_a_line(others, ways):
    with pytest.raises(RunError) as error, importing_ros(*others):
        import no_such_rclpy  # noqa: F401
    assert str(error.value) == (
        f"ROS 2 (rclpy) cannot be loaded: No module named 'no_such_rclpy'; {ways}")
