"""The C header of a controller: structs, constants and calls, as the sources declare them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import inspect
from pathlib import Path
import re
import textwrap
from types import ModuleType
from typing import get_type_hints

from multicontact_control import flags, tick
from multicontact_control.config import contact
from multicontact_control.export.entries import ENTRIES
from multicontact_control.export.field_comments import (
    FieldComment,
    read_constant_comments,
    read_field_comments,
)
from multicontact_control.records import describe_field, record_dtype
from multicontact_control.supervision import causes, contacts, input_checks
import numpy as np

FILES = Path(__file__).with_name('files')
WIDTH = 99
C_TYPES = {
    np.float64: 'double',
    np.int64: 'int64_t',
    np.bool_: 'bool',
    np.uint8: 'uint8_t',
}
READING_PROBLEMS = (
    'ABSENT',
    'FINE',
    'INVALID',
    'JUMP',
    'FROZEN',
    'SATURATED',
    'STAMP',
    'BACKWARDS',
    'RATE',
    'VELOCITY',
    'OUTLIER',
)
REACTIONS = ('TO_NONE', 'TO_INFLATE', 'TO_HOLD', 'TO_FLOAT', 'TO_DAMP', 'TO_SAFE')
CONTACT_STATES = (
    'FREE',
    'APPROACHING',
    'IMPACT',
    'HOLDING',
    'LOST',
    'RETRACTING',
    'GIVEN_UP',
)


def write_header(
    memory: type, layout: int, values: Mapping[str, object], names: Sequence[str]
) -> str:
    """
    Return the text of the header of a controller.

    Parameters
    ----------
    memory
        The record of all that it works on.
    layout
        Number of its layout, by which library, header and records know each other.
    values
        Constants of the configuration, by their names in C.
    names
        Names of the forces and couples, in the order of `contacts`.

    """
    structs: dict[type, str] = {}
    _add_struct(memory, structs)
    constants = [_define(name, value) for name, value in values.items()]
    constants += _define_constants(flags, _list_integers(flags))
    constants += [
        '',
        '/* Stages of a tick. */',
        *_define_constants(tick, ('SEE', 'ACT')),
    ]
    constants += ['', '/* What answers a tick: `supervisions[0].reaction`. */']
    constants += _define_constants(causes, REACTIONS)
    constants += [
        '',
        '/* Why the law does not answer, or not as usual: bits of `supervisions[0].causes`. */',
    ]
    constants += [_define(what.upper(), bit) for bit, what in causes.NAMES.items()]
    constants += ['', '/* What is wrong with a reading; what came of one: `*_came`. */']
    constants += _define_constants(input_checks, READING_PROBLEMS)
    constants += ['', '/* What a column of N is: `contacts[i].config.kind`. */']
    constants += _define_constants(contact, ('FORCE', 'ALONG', 'ACROSS'))
    constants += ['', '/* The state of a contact: `states[i].state`. */']
    constants += _define_constants(contacts, CONTACT_STATES, 'CONTACT_')
    parts = {
        'LAYOUT': f'0x{layout:016x}',
        'CONSTANTS': '\n'.join(constants),
        'STRUCTS': '\n\n'.join(structs.values()),
        'COLUMNS': ', '.join(names),
        'CALLS': '\n\n'.join(map(_declare, ENTRIES)),
    }
    text = (FILES / 'multicontact_tick.h').read_text(encoding='utf-8')
    for name, part in parts.items():
        text = text.replace(f'@{name}@', part)
    return text


def name_struct(record: type) -> str:
    """Return the name in C of a record."""
    words = re.sub(r'(?<=[a-z])(?=[A-Z])', '_', record.__name__)
    return f'mc_{words.lower()}'


def _declare(name: str) -> str:
    """Return the declaration of an entry, below what its docstring says."""
    entry = ENTRIES[name]
    _, *numbers = inspect.signature(entry).parameters
    arguments = ''.join(f', int64_t {number}' for number in numbers)
    declared = f'int64_t {name}(mc_controller *controller{arguments});'
    return '\n'.join([*_comment(inspect.getdoc(entry) or '', ''), declared])


def _list_integers(module: ModuleType) -> list[str]:
    """Return the names of the numbers of a module."""
    return [name for name, value in vars(module).items() if isinstance(value, int)]


def _define(name: str, value: object) -> str:
    """Return a constant of C."""
    text = f'({value})'
    if isinstance(value, str):
        text = f'"{value}"'
    elif isinstance(value, tuple):
        text = '{' + ', '.join(map(str, value)) + '}'
    return f'#define MC_{name} {text}'


def _define_constants(
    module: ModuleType, names: Sequence[str], prefix: str = ''
) -> list[str]:
    """Return constants of a module, below the comments that its source has above them."""
    comments = read_constant_comments(inspect.getsource(module))
    lines = []
    for name in names:
        if comments.get(name):
            lines += ['', *_comment(comments[name], '')]
        lines.append(_define(prefix + name, getattr(module, name)))
    return lines


def _add_struct(record: type, structs: dict[type, str]) -> None:
    """Add the struct of a record behind those that it is made of."""
    if record in structs:
        return
    described = getattr(record, 'described', record)
    comments = read_field_comments(described)
    lines = _comment(inspect.getdoc(described) or '', '')
    lines.append('typedef struct {')
    for field, kind in get_type_hints(record, include_extras=True).items():
        element, shape = describe_field(kind)
        if element in C_TYPES:
            type_name = C_TYPES[element]
        else:
            _add_struct(element, structs)
            type_name = name_struct(element)
        comment = comments.get(field, FieldComment())
        if comment.apart:
            lines.append('')
        if comment.above:
            lines += _comment(comment.above, '    ')
        sizes = ''.join(f'[{size}]' for size in shape)
        line = f'    {type_name} {field}{sizes};'
        if comment.behind:
            line += f' /* {comment.behind} */'
        lines.append(line)
    name = name_struct(record)
    size = record_dtype(record).itemsize
    lines.append(f'}} {name};')
    lines.append(f'MC_ASSERT(sizeof({name}) == {size}, "{name}");')
    structs[record] = '\n'.join(lines)


def _comment(text: str, indent: str) -> list[str]:
    """Return a text as a comment of C."""
    paragraphs = inspect.cleandoc(text).split('\n\n')
    lines = []
    for paragraph in paragraphs:
        lines += textwrap.wrap(paragraph, WIDTH - len(indent) - 6)
    if len(lines) == 1:
        return [f'{indent}/* {lines[0]} */']
    starts = ['/* '] + ['   '] * (len(lines) - 1)
    ends = [''] * (len(lines) - 1) + [' */']
    return [
        f'{indent}{start}{line}{end}' for start, line, end in zip(starts, lines, ends)
    ]
