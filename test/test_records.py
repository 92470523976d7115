"""Records have the layout of C structures, and compiled functions are typed by them."""

import ast
from pathlib import Path
import re
from typing import Annotated, Protocol

from multicontact_control.arrays import Bytes, Vector
from multicontact_control.records import Record, record_dtype, Records

ROOT = Path(__file__).resolve().parents[1]


class Inner(Record, Protocol):
    """What is in another."""

    valid: bool
    count: int


class Outer(Record, Protocol):
    """What has others."""

    flags: Annotated[Bytes, 3]
    place: Annotated[Vector, 2, 3]
    inner: Inner
    others: Annotated[Records[Inner], 4]


def test_record_dtype_is_the_layout_of_a_c_structure():
    dtype = record_dtype(Outer)
    assert dtype.names == ('flags', 'place', 'inner', 'others')
    assert [dtype.fields[name][1] for name in dtype.names] == [0, 8, 56, 72]
    assert dtype['place'].shape == (2, 3)
    assert dtype['others'].subdtype == (dtype['inner'], (4,))
    assert dtype['inner'].itemsize == 16


def sources():
    """Yield path and text of every module."""
    for package in ('multicontact_control', 'sim_bridge'):
        for path in sorted((ROOT / package).rglob('*.py')):
            yield path.relative_to(ROOT), path.read_text()


def test_no_compiled_function_takes_or_returns_anything():
    unknown = []
    for path, text in sources():
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.FunctionDef):
                continue
            if 'compiled' not in map(ast.unparse, node.decorator_list):
                continue
            types = [argument.annotation for argument in node.args.args] + [
                node.returns
            ]
            if any(
                re.search(r'\bAny\b', ast.unparse(annotation)) for annotation in types
            ):
                unknown.append(f'{path}: {node.name}')
    assert unknown == []
