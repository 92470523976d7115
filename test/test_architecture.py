"""The rules of who may import whom and how large each room may be, held against the sources."""

from __future__ import annotations

import ast
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
import io
from pathlib import Path
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
    'faults': 8,
    'study': 9,
    'view': 9,
    'cli': 10,
    '__main__': 10,
}
PINOCCHIO_HOME = 'multicontact_control.dynamics.robot'
PRIVATE = 'multicontact_control.nodes.private'
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
    TOP: 8_300,
    'dynamics': 6_600,
    'contact': 4_600,
    'force': 16_000,
    'control': 9_100,
    LOOP: 3_500,
    'supervision': 28_600,
    'diagnosis': 3_400,
    'sensor': 3_300,
    'config': 6_400,
    'nodes': 28_700,
    'runs': 17_500,
    'judging': 22_800,
    'commissioning': 6_900,
    'faults': 12_200,
    'study': 17_300,
    'view': 20_500,
    'cli': 6_200,
    'sim_bridge': 30_400,
    'test': 165_800,
    'test/campaign': 9_200,
    'benchmarks': 3_300,
}
MOST_COMPILED = 146  # functions
# How the product reads, as a whole: nodes of the syntax tree per simple statement, on average and
# for 95 of 100; conditional expressions and comprehensions; functions of more than six arguments.
MEAN_NODES, MOST_NODES = 11.6, 27
FOLDS_PER_STATEMENT = 0.029
WORDS_PER_DOCSTRING, LETTERS_PER_NAME = 31.0, 11.6
CROWDED_FUNCTIONS = 16


def sources(*folders: str) -> dict[str, str]:
    """Return the text of every module of some folders, by dotted name."""
    texts = {}
    for path in sorted(
        path for folder in folders for path in (ROOT / folder).rglob('*.py')
    ):
        parts = path.relative_to(ROOT).with_suffix('').parts
        texts['.'.join(parts[:-1] if parts[-1] == '__init__' else parts)] = (
            path.read_text(encoding='utf-8')
        )
    return texts


@cache
def imports() -> dict[str, set[str]]:
    """Return the modules that each module imports, wherever in the module it does so."""
    modules = sources('multicontact_control', 'sim_bridge')
    graph = {}
    for name, text in modules.items():
        targets: set[str] = set()
        for node in ast.walk(ast.parse(text, name)):
            if isinstance(node, ast.Import):
                targets.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f'{name}: a relative import'
                inner = {
                    f'{node.module}.{alias.name}' for alias in node.names
                } & modules.keys()
                targets.update(inner or {node.module})
        graph[name] = targets - {name}
    return graph


def is_ros(module: str) -> bool:
    top = module.split('.')[0]
    return top in (
        'rclpy',
        'ament_index_python',
        'rosidl_runtime_py',
        'rosidl_parser',
    ) or (top.endswith(('_msgs', '_srvs', '_interfaces')))


def area(module: str) -> str:
    """Return the part of the package a module belongs to, e.g. 'force'; '' for another package."""
    package, *inner = module.split('.')
    return (
        (inner[0] if inner else '__init__') if package == 'multicontact_control' else ''
    )


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
    assert [
        f'{module} imports {target}: {rule}'
        for module, targets in imports().items()
        for target in sorted(targets)
        if (rule := broken_rule(module, target))
    ] == []
    TopologicalSorter(imports()).prepare()  # CycleError names an import cycle


def room(module: str) -> str:
    package, *inner = module.split('.')
    if package == 'multicontact_control':
        name = (inner or [''])[0]
        return (
            LOOP if name in ('loop', 'sampling') else name if name in BUDGETS else TOP
        )
    return 'test/campaign' if (package, *inner[:1]) == ('test', 'campaign') else package


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
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(
        token.type in CODE and token.start[0] not in documented for token in tokens
    )


def test_rooms_stay_within_their_budgets():
    tokens: Counter[str] = Counter()
    for module, text in sources(
        'multicontact_control', 'sim_bridge', 'test', 'benchmarks'
    ).items():
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
    names = [argument.arg for argument in function.args.args]
    return (
        len(names) + len(function.args.kwonlyargs) - (names[:1] in (['self'], ['cls']))
    )


def test_product_reads_aloud():
    """What stands in a statement, what names and docstrings say; on the syntax tree."""
    nodes = [
        node
        for text in sources('multicontact_control', 'sim_bridge').values()
        for node in ast.walk(ast.parse(text))
    ]
    weights = sorted(
        sum(1 for _ in ast.walk(node)) for node in nodes if is_simple_statement(node)
    )
    statements = sum(isinstance(node, ast.stmt) for node in nodes)
    folds = sum(isinstance(node, FOLDS) for node in nodes)
    definitions = [node for node in nodes if isinstance(node, DEFINITIONS)]
    public = [node for node in definitions if not node.name.startswith('_')]
    words = sum(len((ast.get_docstring(node) or '').split()) for node in public)
    letters = sum(len(node.name.strip('_')) for node in definitions)
    functions = [node for node in definitions if isinstance(node, ast.FunctionDef)]
    crowded = [node.name for node in functions if count_arguments(node) > 6]
    assert sum(weights) / len(weights) <= MEAN_NODES
    assert weights[int(0.95 * (len(weights) - 1))] <= MOST_NODES
    assert folds / statements <= FOLDS_PER_STATEMENT
    assert words / len(public) >= WORDS_PER_DOCSTRING
    assert letters / len(definitions) >= LETTERS_PER_NAME
    assert len(crowded) <= CROWDED_FUNCTIONS, crowded


def test_compiled_functions_are_few():
    assert (
        sum(
            line.strip() == '@compiled'
            for text in sources('multicontact_control', 'sim_bridge').values()
            for line in text.splitlines()
        )
        <= MOST_COMPILED
    )
