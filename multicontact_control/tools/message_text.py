"""Messages as `ros2 topic echo` writes them."""

from __future__ import annotations

from array import array
import sys
from typing import Any

from multicontact_control.errors import ConfigError
import numpy as np
import yaml

TRUNCATE_LENGTH = 128
SEPARATOR = '---'


def document(message: Any, field: str = '', truncate: int | None = TRUNCATE_LENGTH) -> str:
    """
    Return one message, or a field of it, as text that ends with the separator.

    Parameters
    ----------
    message
        Any ROS message.
    field
        Dotted path of the field, e.g. ``header.stamp``; empty for all.
    truncate
        Length beyond which lists and strings are cut; None for never.

    Raises
    ------
    ConfigError
        If the message has no such field.

    """
    chosen = pick(message, field)
    if not hasattr(chosen, 'get_fields_and_field_types'):
        return f'{chosen}\n{SEPARATOR}'
    text: str = yaml.safe_dump(
        plain(chosen, truncate), allow_unicode=True, width=sys.maxsize, sort_keys=False,
        default_flow_style=False)
    return f'{text}{SEPARATOR}'


def pick(message: Any, field: str) -> Any:
    """
    Return a field of a message by its dotted path.

    Raises
    ------
    ConfigError
        If there is none.

    """
    for name in filter(None, field.split('.')):
        fields = getattr(message, 'get_fields_and_field_types', None)
        known: dict[str, str] = fields() if fields is not None else {}
        if name not in known:
            raise ConfigError(
                '--field', f'one of {", ".join(known) or "no further fields"}', f"'{name}'")
        message = getattr(message, name)
    return message


def plain(value: Any, truncate: int | None) -> Any:
    """Return a message or a value of a field as what YAML knows."""
    if hasattr(value, 'get_fields_and_field_types'):
        return {name: plain(getattr(value, name), truncate)
                for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        value = value.decode('latin-1')
    if isinstance(value, str):
        cut = truncate is not None and len(value) > truncate
        return f'{value[:truncate]}...' if cut else value
    if isinstance(value, (list, tuple, array, np.ndarray)):
        cut = truncate is not None and len(value) > truncate
        items = [plain(x, truncate) for x in (value[:truncate] if cut else value)]
        return [*items, '...'] if cut else items
    return value.item() if isinstance(value, np.generic) else value
