"""Records have the layout of C structures, and compiled functions are typed by them."""

import ast
import re
from typing import Annotated, Protocol

from multicontact_control.arrays import Bytes, Vector
from multicontact_control.records import Record, record_dtype, Records
from test_architecture import sources


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


def test_no_compiled_function_takes_or_returns_anything():
    for module, text in sources('multicontact_control', 'sim_bridge').items():
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.FunctionDef):
                continue
            if 'compiled' not in map(ast.unparse, node.decorator_list):
                continue
            signature = f'{ast.unparse(node.args)} {ast.unparse(node.returns)}'
            assert not re.search(r'\bAny\b', signature), f'{module}.{node.name}'
