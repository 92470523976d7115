"""What the sources say of the fields of a record: the comments behind and above them."""

from __future__ import annotations

import ast
import inspect
import io
import textwrap
import tokenize
from typing import NamedTuple


class FieldComment(NamedTuple):
    """Comments of a field, without `#`: of a group of fields that begins here, and its own."""

    above: str = ''
    behind: str = ''
    apart: bool = False  # whether an empty line is above it


def read_field_comments(record: type) -> dict[str, FieldComment]:
    """Return the comments of the annotated fields of a class, by their names."""
    source = textwrap.dedent(inspect.getsource(record))
    above: dict[int, str] = {}
    behind: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        place = behind
        if not token.line[: token.start[1]].strip():
            place = above
        place[token.start[0]] = token.string.lstrip('# ')
    (definition,) = ast.parse(source).body
    source_lines = source.splitlines()
    comments = {}
    for statement in ast.walk(definition):
        if not isinstance(statement, ast.AnnAssign):
            continue
        if isinstance(statement.target, ast.Name):
            lines: list[str] = []
            line = statement.lineno - 1
            while line in above:
                lines.insert(0, above[line])
                line -= 1
            comments[statement.target.id] = FieldComment(
                ' '.join(lines),
                behind.get(statement.end_lineno or 0, ''),
                not source_lines[line - 1].strip(),
            )
    return comments


def read_constant_comments(source: str) -> dict[str, str]:
    """Return the comment lines above the constants of a module, by the constants' names."""
    lines = source.splitlines()
    comments = {}
    for statement in ast.parse(source).body:
        if not isinstance(statement, ast.Assign):
            continue
        above: list[str] = []
        line = statement.lineno - 2
        while lines[line].startswith('#'):
            above.insert(0, lines[line].lstrip('# '))
            line -= 1
        for target in statement.targets:
            if isinstance(target, ast.Name):
                comments[target.id] = ' '.join(above)
    return comments
