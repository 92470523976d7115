"""The errors this package raises: one root; a bad value is named by field, expected and got."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any


class MulticontactError(Exception):
    """Root of every error raised by this package: catch it to catch them all."""


class FieldError(MulticontactError):
    """
    A value is not acceptable.

    Parameters
    ----------
    field
        Its dotted name, e.g. ``contacts.table.normal_world``.
    expected
        What is acceptable, with its unit; empty if the hint says all.
    got
        What was given; None if there is nothing to show.
    source
        The file that it stands in.
    hint
        What to do, or why.

    Attributes
    ----------
    errors
        One for each value that is not acceptable: this one, or those that were combined.

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
        self.field = field
        self.expected = expected
        self.got = got
        self.source = source
        self.hint = hint
        self.errors: tuple[Any, ...] = (self,)
        values = []
        if expected:
            values.append(f'expected {expected}')
        if got is not None:
            values.append(f'got {got}')
        text = ', '.join(values)
        if hint:
            text = f'{text}; {hint}' if text else hint
        place = f'{source}: {field}' if source else field
        super().__init__(f'{place}: {text}')

    def as_config_error(self, field: str = '', source: str = '') -> ConfigError:
        """Return the same as an error of a configuration, of another field or file if named."""
        return ConfigError(
            field or self.field,
            self.expected,
            self.got,
            source or self.source,
            hint=self.hint,
        )


class CommandError(FieldError):
    """A command cannot be obeyed now, e.g. because the arm is held or presses on a surface."""


class MessageError(FieldError):
    """A message cannot be used, or must not be sent."""


class ConfigError(FieldError):
    """One or several values in a configuration are not acceptable: a line for each."""

    @classmethod
    def combine(cls, errors: Iterable[ConfigError], source: str = '') -> ConfigError:
        """
        Return one error of one or more, with a line for each; equal lines stand once.

        Its field is that of the first; its file is `source`, or else that of the first.
        """
        by_line: dict[str, ConfigError] = {}
        for error in errors:
            for part in error.errors:
                placed = part.as_config_error(source=source)
                by_line.setdefault(str(placed), placed)
        parts = tuple(by_line.values())
        combined = parts[0].as_config_error()
        combined.errors = parts
        combined.args = ('\n'.join(by_line),)
        return combined


class ShapeError(FieldError):
    """An array does not have the shape its function documents: both shapes are named."""


class SingularTaskError(MulticontactError):
    """The arm cannot accelerate its operational point in every direction in this posture."""


class ContactGeometryError(MulticontactError):
    """The contact normals do not span independent directions at the operational point."""


class CalibrationError(MulticontactError):
    """The readings do not determine the quantities to be identified."""


class RunError(MulticontactError):
    """A run could not start or did not end as it should."""


class RosError(RunError, ImportError):
    """ROS 2 cannot be loaded: what needs it says how to install it, the rest goes on."""


class PinocchioError(RunError, ImportError):
    """Pinocchio cannot be loaded, or computes other terms than it should."""


def run_all_checks(*checks: Callable[[], object]) -> list[Any]:
    """Call every check and return their results; ConfigError with the errors of all of them."""
    results = []
    errors = []
    for check in checks:
        try:
            results.append(check())
        except ConfigError as error:
            errors.append(error)
    if errors:
        raise ConfigError.combine(errors)
    return results


def format_count(number: int, plural: str) -> str:
    """Return a number with its noun, e.g. '1 value'; the plural of the noun ends in s."""
    noun = plural.removesuffix('s') if number == 1 else plural
    return f'{number} {noun}'
