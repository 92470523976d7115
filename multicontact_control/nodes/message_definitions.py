"""Installed message types: their classes, and their text as recordings carry it along."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
import json
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory, PackageNotFoundError
from multicontact_control.errors import RunError
from multicontact_control.nodes.runtime import prepare_environment

# The one type that is recorded without being installed: the wheels have no tf2_msgs.
TF_TYPE = 'tf2_msgs/msg/TFMessage'
TF_TEXT = 'geometry_msgs/TransformStamped[] transforms\n'
TF_HASH = 'RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087'
SEPARATOR = '=' * 80
PRIMITIVES = frozenset((
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring'))


def message_file(type_name: str, suffix: str) -> Path:
    """
    Return a file that describes a message type.

    Parameters
    ----------
    type_name
        For example ``sensor_msgs/msg/JointState``.
    suffix
        ``.msg`` for its text, ``.json`` for its hash.

    Raises
    ------
    RunError
        If the type is not installed.

    """
    prepare_environment()
    package, _, name = type_name.partition('/msg/')
    try:
        share = Path(get_package_share_directory(package))
    except (PackageNotFoundError, ValueError):
        raise RunError(f'{type_name}: package {package} is not installed') from None
    path = share / 'msg' / f'{name}{suffix}'
    if not path.is_file():
        raise RunError(f'{type_name}: {path} does not exist')
    return path


def message_class(type_name: str) -> Any:
    """
    Return the class of a message type, e.g. that of ``sensor_msgs/msg/JointState``.

    Raises
    ------
    RunError
        If it is not installed.

    """
    package, _, name = type_name.partition('/msg/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        raise RunError(f'{type_name}: this message type is not installed') from None


def message_text(type_name: str) -> str:
    """
    Return the definition of a message type followed by those of all types in it (``ros2msg``).

    Raises
    ------
    RunError
        If a type is not installed.

    """
    texts = {type_name: _text(type_name)}
    waiting = [type_name]
    while waiting:
        current = waiting.pop(0)
        for inner in _inner_types(texts[current], current.split('/')[0]):
            if inner not in texts:
                texts[inner] = _text(inner)
                waiting.append(inner)
    main = texts.pop(type_name)
    parts = [f'{SEPARATOR}\nMSG: {name.replace("/msg/", "/")}\n{text}'
             for name, text in texts.items()]
    return '\n'.join([main.rstrip('\n'), *(part.rstrip('\n') for part in parts)]) + '\n'


def _text(type_name: str) -> str:
    if type_name == TF_TYPE:
        return TF_TEXT
    return message_file(type_name, '.msg').read_text(encoding='utf-8')


def message_hash(type_name: str) -> str:
    """Return the RIHS01 hash of a message type, empty if it is not installed with one."""
    if type_name == TF_TYPE:
        return TF_HASH
    try:
        description = json.loads(message_file(type_name, '.json').read_text(encoding='utf-8'))
        hashes = description['type_hashes']
    except (RunError, KeyError, ValueError):
        return ''
    return next((x['hash_string'] for x in hashes if x.get('type_name') == type_name), '')


def _inner_types(text: str, package: str) -> Iterator[str]:
    """Yield the message types that the fields of a definition have."""
    for line in text.splitlines():
        fields = line.split('#', 1)[0].split()
        if len(fields) < 2:
            continue
        base = fields[0].split('[', 1)[0].split('<', 1)[0]
        if base in PRIMITIVES:
            continue
        owner, _, name = base.rpartition('/')
        yield f'{(owner or package).removesuffix("/msg")}/msg/{name}'
