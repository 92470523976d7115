"""The errors this package raises: one root, each saying what was expected and what was found."""

from collections.abc import Callable


class MulticontactError(Exception):
    """Root of every error raised by this package."""


class ConfigError(MulticontactError):
    """
    A value in a configuration is not acceptable.

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

    """

    def __init__(self, field: str, expected: str, found: object, source: str = '') -> None:
        self.field = field
        self.expected = expected
        self.found = found
        self.source = source
        self.cause = f'{field}: expected {expected}'  # whatever was found
        where = f'{source}: ' if source else ''
        super().__init__(f'{where}{field}: expected {expected}, found {found}')


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


def check_all(*checks: Callable[[], object]) -> None:
    """
    Call every check, whatever the others found.

    Raises
    ------
    ConfigError
        With all that was not acceptable, in one line.

    """
    errors = []
    for check in checks:
        try:
            check()
        except ConfigError as error:
            errors.append(error)
    if errors:
        errors[0].args = ('; '.join(map(str, errors)),)
        raise errors[0]
