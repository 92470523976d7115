"""The type of every record says what its dtype does, and compiled functions are typed by them."""

import ast
from functools import cache
from importlib import import_module
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[1]
DTYPE = re.compile(r'^([A-Z_]+) = np\.dtype\(', re.MULTILINE)
NUMBERS = {'f': 'float', 'i': 'int', 'u': 'int', 'b': 'bool'}
ARRAYS = {'f': ('Vector', 'Matrix'), 'b': ('Mask', 'Mask'), 'u': ('Bytes', 'Bytes')}


def sources():
    """Yield path and text of every module."""
    for package in ('multicontact_control', 'sim_bridge'):
        for path in sorted((ROOT / package).rglob('*.py')):
            yield path.relative_to(ROOT), path.read_text()


def class_name(name):
    """Return JointConfig for JOINT_CONFIG."""
    return ''.join(word.capitalize() for word in name.split('_'))


@cache
def records():
    """Return module and dtype of every record, by the dtype's name."""
    found = {}
    for path, text in sources():
        for name in DTYPE.findall(text):
            module = import_module('.'.join(path.with_suffix('').parts))
            assert name not in found
            found[name] = module, getattr(module, name)
    return found


def types_of(dtype):
    """Return what a field may be said to be: records that are alike have different types."""
    if dtype.subdtype is not None:
        element, shape = dtype.subdtype
        if element.names is not None:
            return {f'Records[{name}]' for name in types_of(element)}
        return {ARRAYS[element.kind][len(shape) > 1]}
    if dtype.names is not None:
        return {class_name(name) for name, (_, other) in records().items() if other == dtype}
    return {NUMBERS[dtype.kind]}


@pytest.mark.parametrize('name', sorted(records()))
def test_type_of_a_record_is_that_of_its_dtype(name):
    module, dtype = records()[name]
    said = getattr(module, class_name(name)).__annotations__
    assert list(said) == list(dtype.names)
    for field, annotation in said.items():
        assert annotation in types_of(dtype[field]), field


def test_no_compiled_function_takes_or_returns_anything():
    unknown = []
    for path, text in sources():
        for node in ast.walk(ast.parse(text)):
            if not isinstance(node, ast.FunctionDef):
                continue
            if 'compiled' not in map(ast.unparse, node.decorator_list):
                continue
            types = [argument.annotation for argument in node.args.args] + [node.returns]
            if any(re.search(r'\bAny\b', ast.unparse(annotation)) for annotation in types):
                unknown.append(f'{path}: {node.name}')
    assert unknown == []
