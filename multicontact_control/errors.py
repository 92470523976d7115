"""The errors this package raises: one root, each saying what was expected and what was found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any


class MulticontactError(Exception):
    """Root of every error raised by this package."""


class ConfigError(MulticontactError):
    """
    A value in a configuration is not acceptable, or several are: then there is a line for each.

    Parameters
    ----------
    field
        Dotted name of the field, e.g. ``contacts.table.normal_world``.
    expected
        What would have been accepted, with its unit.
    found
        What was there.
    source
        File the value came from, if any.

    Attributes
    ----------
    errors
        One error per value; this one alone if there is only one.

    """

    def __init__(self, field: str, expected: str, found: object, source: str = '') -> None:
        self.field = field
        self.expected = expected
        self.found = found
        self.source = source
        self.cause = f'{field}: expected {expected}'  # whatever was found
        where = f'{source}: ' if source else ''
        super().__init__(f'{where}{field}: expected {expected}, found {found}')
        self._all: tuple[ConfigError, ...] = ()

    @property
    def errors(self) -> tuple[ConfigError, ...]:
        """Return the errors one by one."""
        return self._all or (self,)

    @classmethod
    def of(cls, errors: Iterable[ConfigError]) -> ConfigError:
        """Return one error of at least one; it goes by the name of the first."""
        first, *others = [each for error in errors for each in error.errors]
        if not others:
            return first
        whole = cls(first.field, first.expected, first.found, first.source)
        whole._all = (first, *others)
        whole.cause = '; '.join(error.cause for error in whole._all)
        whole.args = ('\n'.join(map(str, whole._all)),)
        return whole

    def with_source(self, source: str) -> ConfigError:
        """Return the same of a file."""
        return ConfigError.of(
            ConfigError(x.field, x.expected, x.found, source) for x in self.errors)


class ShapeError(MulticontactError):
    """An array does not have the shape its function documents."""

    def __init__(self, name: str, expected: object, found: object) -> None:
        super().__init__(f'{name}: expected shape {expected}, found {found}')


class SingularTaskError(MulticontactError):
    """The arm cannot accelerate its operational point in every direction here."""


class ContactGeometryError(MulticontactError):
    """The contact normals do not span independent directions at the operational point."""


class RunError(MulticontactError):
    """A run could not start or did not end as it should."""


@contextmanager
def importing_ros(*others: str) -> Iterator[None]:
    """
    Say what to do where ROS 2 cannot be loaded.

    Parameters
    ----------
    others
        Ways to do without.

    Raises
    ------
    RunError
        For an `ImportError`.

    """
    try:
        yield
    except ImportError as error:
        *ways, last = 'install the extra [ros]', 'source a ROS 2 Jazzy', *others
        raise RunError(f'ROS 2 (rclpy) cannot be loaded: {error}; '
                       f'{", ".join(ways)} or {last}') from None


class CalibrationError(MulticontactError):
    """The readings do not tell what was to be identified from them."""


class RefusalError(MulticontactError):
    """
    What has come cannot be used.

    Attributes
    ----------
    cause
        The same for all that is refused for the same reason.

    """

    def __init__(self, field: str, expected: str, found: object) -> None:
        self.cause = f'{field}: expected {expected}'
        super().__init__(f'{self.cause}, found {found}')


class CommandError(RefusalError):
    """A command cannot be obeyed."""


class MessageError(RefusalError):
    """A message cannot be used, or must not be sent."""


def check_all(*checks: Callable[[], object]) -> list[Any]:
    """
    Call every check, whatever the others found, and return what they return.

    Raises
    ------
    ConfigError
        With all that was not acceptable, a line for each.

    """
    found, errors = [], []
    for check in checks:
        try:
            found.append(check())
        except ConfigError as error:
            errors.append(error)
    if errors:
        raise ConfigError.of(errors)
    return found
