"""The rules of who may import whom and how large each room may be, held against the sources."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
import io
from pathlib import Path
import re
import tokenize

ROOT = Path(__file__).resolve().parents[1]
# What is not listed (config, errors, arrays, paths, ...) lies at the bottom.
LAYERS = {
    'dynamics': 1,
    'contact': 1,
    'force': 1,
    'control': 2,
    'sensor': 3,
    'supervision': 3,
    'tick': 3,
    'diagnosis': 4,
    'sampling': 4,
    'loop': 4,
    'nodes': 5,
    'runs': 6,
    'client': 6,
    'judging': 7,
    'commissioning': 8,
    'export': 8,
    'faults': 8,
    'study': 9,
    'view': 9,
    'learning': 9,
    'cli': 10,
    '__main__': 10,
}
PINOCCHIO_HOME = 'multicontact_control.dynamics.robot'
PRIVATE = 'multicontact_control.nodes.private'
ROS_PACKAGES = ('rclpy', 'ament_index_python', 'rosidl_runtime_py', 'rosidl_parser')
ROS_INTERFACES = ('_msgs', '_srvs', '_interfaces')
STEPPED = 'multicontact_control.supervision.supervisor'
TORQUE_PATH = (
    'dynamics',
    'contact',
    'force',
    'control',
    'supervision',
    'sampling',
    'loop',
)
# Tokens of code of a room, without docstrings and comments: what it has, and a twentieth more. An
# idea that is added takes one out, or its commit says why the house grows.
TOP, LOOP = 'top', 'loop and sampling'
BUDGETS = {
    TOP: 9_850,
    'dynamics': 8_200,
    'contact': 4_600,
    'force': 25_000,
    'control': 17_150,
    LOOP: 4_200,
    'supervision': 31_400,
    'diagnosis': 3_400,
    'sensor': 3_300,
    'config': 6_800,
    'nodes': 28_700,
    'runs': 17_600,
    'judging': 27_400,
    'commissioning': 10_950,
    'export': 4_500,
    'faults': 12_200,
    'study': 20_200,
    'view': 20_580,
    'learning': 10_500,
    'cli': 8_850,
    'sim_bridge': 31_500,
    'test': 204_000,
    'test/campaign': 9_200,
    'benchmarks': 7_050,
}
MOST_COMPILED = 217  # functions
# How the product reads, as a whole: nodes of the syntax tree per simple statement, on average and
# for 95 of 100; conditional expressions and comprehensions; functions of more than six arguments.
MEAN_NODES, MOST_NODES = 11.6, 27
FOLDS_PER_STATEMENT = 0.029
WORDS_PER_DOCSTRING, LETTERS_PER_NAME = 31.0, 11.6
CROWDED_FUNCTIONS = 16


def sources(*folders: str) -> dict[str, str]:
    """Return the text of every module of some folders, by dotted name."""
    texts = {}
    for folder in folders:
        for path in sorted((ROOT / folder).rglob('*.py')):
            parts = path.relative_to(ROOT).with_suffix('').parts
            name = '.'.join(parts).removesuffix('.__init__')
            texts[name] = path.read_text(encoding='utf-8')
    return texts


def imported_names(node: ast.AST, modules: dict[str, str]) -> set[str]:
    """Return the modules that a statement imports."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if not isinstance(node, ast.ImportFrom):
        return set()
    assert node.level == 0, 'a relative import'
    members = {f'{node.module}.{alias.name}' for alias in node.names}
    return members & modules.keys() or {node.module}


@cache
def imports() -> dict[str, set[str]]:
    """Return the modules that each module imports, wherever in the module it does so."""
    modules = sources('multicontact_control', 'sim_bridge')
    graph = {}
    for name, text in modules.items():
        targets: set[str] = set()
        for node in ast.walk(ast.parse(text, name)):
            targets |= imported_names(node, modules)
        graph[name] = targets - {name}
    return graph


def is_ros(module: str) -> bool:
    top = module.split('.')[0]
    return top in ROS_PACKAGES or top.endswith(ROS_INTERFACES)


def area(module: str) -> str:
    """Return the part of the package a module belongs to, e.g. 'force'; '' for another package."""
    package, *inner = module.split('.')
    if package != 'multicontact_control':
        return ''
    return [*inner, '__init__'][0]


def layer(module: str) -> int:
    return LAYERS.get(area(module), 0)


def is_core(module: str) -> bool:
    return area(module) != '' and layer(module) <= LAYERS['loop']


def broken_rule(module: str, target: str) -> str:
    """Return what an import breaks, or nothing."""
    top = target.split('.')[0]
    if is_core(module) and (is_ros(target) or top in ('pybullet', 'sim_bridge')):
        return 'the core knows neither ROS nor the simulation'
    if top in ('viser', 'websockets') and area(module) != 'view':
        return 'the page is an extra, known to view/ alone'
    if (
        top == 'pinocchio'
        and module != PINOCCHIO_HOME
        and not module.startswith('sim_bridge')
    ):
        return 'pinocchio is wrapped in dynamics/robot.py'
    if target.startswith(STEPPED) and area(module) not in ('supervision', 'loop'):
        return 'samples become torques in loop.py'
    if target.startswith(('rclpy._', 'rclpy.impl')) and module != PRIVATE:
        return 'what is private of rclpy is in nodes/private.py'
    if area(target) == 'diagnosis' and area(module) in TORQUE_PATH:
        # It explains what has led to a reaction, and is asked only then.
        return '' if module == STEPPED else 'no torque needs an explanation'
    if area(module) in ('control', 'supervision') and f'{target}.'.startswith(
        'multicontact_control.force.noise.'
    ):
        return 'R reaches the controller as a number'
    if area(module) and area(target):
        if layer(module) < layer(target):
            return 'imports flow downwards'
        if 'tick' in (area(module), area(target)):
            return ''  # the supervisor steps it, and it calls the kernels of all
        if layer(module) == layer(target) in (1, 3) and area(module) != area(target):
            return (
                'dynamics, contact and force know nothing of each other, nor do sensor and '
                'supervision'
            )
    return ''


def test_sources_keep_the_rules_of_the_architecture():
    assert len(imports()) > 100
    for module, targets in imports().items():
        for target in targets:
            assert broken_rule(module, target) == '', f'{module} imports {target}'


def test_imports_make_no_cycle():
    TopologicalSorter(imports()).prepare()  # CycleError names it


def room(module: str) -> str:
    if module.startswith('test.campaign'):
        return 'test/campaign'
    package = module.split('.')[0]
    name = area(module)
    if not name:
        return package
    if name in ('loop', 'sampling'):
        return LOOP
    if name in BUDGETS:
        return name
    return TOP


CODE = (tokenize.NAME, tokenize.OP, tokenize.NUMBER, tokenize.STRING)
FOLDS = (ast.IfExp, ast.ListComp, ast.GeneratorExp, ast.DictComp, ast.SetComp)
DEFINITIONS = (ast.FunctionDef, ast.ClassDef)


def tokens_of(text: str) -> int:
    """Return how many tokens of code a module has, docstrings aside."""
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (*DEFINITIONS, ast.Module)) and ast.get_docstring(node):
            docstring = node.body[0]
            documented.update(range(docstring.lineno, docstring.end_lineno + 1))
    count = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        count += token.type in CODE and token.start[0] not in documented
    return count


def test_rooms_stay_within_their_budgets():
    tokens: Counter[str] = Counter()
    texts = sources('multicontact_control', 'sim_bridge', 'test', 'benchmarks')
    for module, text in texts.items():
        tokens[room(module)] += tokens_of(text)
    assert tokens.keys() == BUDGETS.keys()
    over = {name: count for name, count in tokens.items() if count > BUDGETS[name]}
    assert over == {}


def is_simple_statement(node: ast.AST) -> bool:
    """Tell a statement that ends on its line from one with a body, or a docstring."""
    if not isinstance(node, ast.stmt) or hasattr(node, 'body'):
        return False
    return not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant))


def count_arguments(function: ast.FunctionDef) -> int:
    """Return how many arguments a caller gives."""
    arguments = function.args
    count = len(arguments.args) + len(arguments.kwonlyargs)
    if arguments.args and arguments.args[0].arg in ('self', 'cls'):
        return count - 1
    return count


@cache
def product_nodes() -> list[ast.AST]:
    nodes: list[ast.AST] = []
    for text in sources('multicontact_control', 'sim_bridge').values():
        nodes.extend(ast.walk(ast.parse(text)))
    return nodes


def find_nodes(*kinds: type) -> list[ast.AST]:
    return [node for node in product_nodes() if isinstance(node, kinds)]


def test_statements_of_the_product_hold_few_nodes():
    simple = filter(is_simple_statement, product_nodes())
    weights = sorted(len(list(ast.walk(node))) for node in simple)
    assert sum(weights) / len(weights) <= MEAN_NODES
    assert weights[int(0.95 * (len(weights) - 1))] <= MOST_NODES


def test_product_has_few_conditional_expressions_and_comprehensions():
    folds = find_nodes(*FOLDS)
    assert len(folds) / len(find_nodes(ast.stmt)) <= FOLDS_PER_STATEMENT


def test_names_and_docstrings_of_the_product_say_something():
    definitions = find_nodes(*DEFINITIONS)
    letters = sum(len(node.name.strip('_')) for node in definitions)
    assert letters / len(definitions) >= LETTERS_PER_NAME
    public = [node for node in definitions if not node.name.startswith('_')]
    words = ' '.join(ast.get_docstring(node) or '' for node in public).split()
    assert len(words) / len(public) >= WORDS_PER_DOCSTRING


def test_functions_with_more_than_six_arguments_are_few():
    functions = find_nodes(ast.FunctionDef)
    crowded = [node.name for node in functions if count_arguments(node) > 6]
    assert len(crowded) <= CROWDED_FUNCTIONS, crowded


def test_compiled_functions_are_few():
    texts = '\n'.join(sources('multicontact_control', 'sim_bridge').values())
    compiled = re.findall(r'^\s*@compiled$', texts, re.MULTILINE)
    assert len(compiled) <= MOST_COMPILED
