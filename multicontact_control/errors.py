"""The errors this package raises: one root; a bad value is named by field, expected and got."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any


class MulticontactError(Exception):
    """Root of every error raised by this package."""


class FieldError(MulticontactError):
    """
    A value is not acceptable.

    Named are its dotted field, e.g. ``contacts.table.normal_world``, its file (`source`), what was
    expected, with its unit, what was given, and what to do: each part where it says something.
    """

    def __init__(
        self,
        field: str,
        expected: str = '',
        got: object = None,
        source: str = '',
        *,
        hint: str = '',
    ) -> None:
        self.field, self.expected, self.got, self.source = field, expected, got, source
        self.hint = hint
        self.errors: tuple[Any, ...] = (self,)  # one per value
        where = f'{source}: {field}' if source else field
        values = [
            *([f'expected {expected}'] if expected else []),
            *([] if got is None else [f'got {got}']),
        ]
        super().__init__(
            f'{where}: {"; ".join(filter(None, [", ".join(values), hint]))}'
        )

    def moved(self, field: str = '', source: str = '') -> ConfigError:
        """Return the same as an error of a configuration, of another field or file."""
        return ConfigError(
            field or self.field,
            self.expected,
            self.got,
            source or self.source,
            hint=self.hint,
        )


class CommandError(FieldError):
    """A command cannot be obeyed."""


class MessageError(FieldError):
    """A message cannot be used, or must not be sent."""


class ConfigError(FieldError):
    """One or several values in a configuration are not acceptable: a line for each."""

    @classmethod
    def of(cls, errors: Iterable[ConfigError], source: str = '') -> ConfigError:
        """Return one error of one or more, each once, with the first field, of a file `source`."""
        each = [x.moved(source=source) for error in errors for x in error.errors]
        lines = {str(error): error for error in each}
        whole = each[0].moved()
        whole.errors, whole.args = (*lines.values(),), ('\n'.join(lines),)
        return whole


class ShapeError(FieldError):
    """An array does not have the shape its function documents."""


class SingularTaskError(MulticontactError):
    """The arm cannot accelerate its operational point in every direction."""


class ContactGeometryError(MulticontactError):
    """The contact normals do not span independent directions at the operational point."""


class CalibrationError(MulticontactError):
    """The readings do not determine the quantities to be identified."""


class RunError(MulticontactError):
    """A run could not start or did not end as it should."""


class RosError(RunError, ImportError):
    """ROS 2 cannot be loaded."""


def run_all_checks(*checks: Callable[[], object]) -> list[Any]:
    """Call every check, return their results; ConfigError with the errors of all of them."""
    results, errors = [], []
    for check in checks:
        try:
            results.append(check())
        except ConfigError as error:
            errors.append(error)
    if errors:
        raise ConfigError.of(errors)
    return results


def format_count(number: int, what: str) -> str:
    """Return a number with its noun; `what` is the plural, which ends in s."""
    return f'{number} {what.removesuffix("s") if number == 1 else what}'
