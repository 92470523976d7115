"""
Every command and program in the documents is one that can be given as it stands there.

Of each ```sh block all lines are taken, `&&` and continued lines included; those that begin with
none of OTHERS are commands of `multicontact` and targets of `make`. The tutorial is followed in
one folder from its first line to its last, but for NOT_FOLLOWED.
"""

import ast
from dataclasses import fields
import inspect
from pathlib import Path
import re
import shlex

from multicontact_control.cli.application import app
from multicontact_control.cli.options import RunOptions
from multicontact_control.client import ArmState, MultiContactClient
from multicontact_control.judging.results import load_run
from multicontact_control.nodes import messages, topics
from multicontact_control.study.config import (
    apply_choices,
    read_choices,
    read_study,
)
import pytest
from robots import has_urdf
from ros_graph import ROOT, write_bag
from test_docs import prose
import typer

DOCUMENTS = [
    ROOT / 'README.md',
    ROOT / 'CONTRIBUTING.md',
    ROOT / 'SECURITY.md',
    *sorted((ROOT / 'docs').glob('*.md')),
]
TUTORIAL = ROOT / 'docs/tutorial.md'
FIRST = Path('runs/first')
# Files that are the reader's own.
YOURS = {
    'my_arm.urdf',
    'arm.urdf',
    'ur5e.urdf',
    'my_arm.yaml',
    'controller.yaml',
    'tool.yaml',
    'ur.yaml',
}
OTHERS = (
    'python examples/learn_to_wipe.py',
    '. ',
    'cmake',
    'controller_node --autostart --ros-args',
    'cp',
    'dask',
    'franka_bridge',
    'lerobot-train',
    'noise_estimator_node --autostart --ros-args',
    'pip install',
    'python benchmarks/',
    'python docs/',
    'python ur_wrench.py',
    'python3 -m venv',
    'recorder_node --ros-args',
    'ros2 launch',
    'ros2 control',
    'ros2 service call',
    'ros2 param set /sim_node ',
    'ros2 topic pub --once /sim_node/push',
    'ros2 run robot_state_publisher',
    'ros2 run tf2_ros',
    'ssh',
    'strict/bin/',
    'sudo apt install',
    'tsid/bin/pip install',
)


def blocks(document, language):
    """Return the blocks of a language in a document: line, text."""
    text = document.read_text(encoding='utf-8')
    fenced = rf'^```{language}\n(.*?)^```$'
    found = []
    for match in re.finditer(fenced, text, re.MULTILINE | re.DOTALL):
        line = text.count('\n', 0, match.start()) + 1
        found.append((line, match[1]))
    return found


def lines_of(block):
    """Return the lines of a block, each with those that it goes on in."""
    return re.sub(r'\\\n\s*', ' ', block).splitlines()


def commands(document):
    """Yield the commands of a document: the block it stands in, its words."""
    for start, block in blocks(document, 'sh'):
        for line in lines_of(block):
            for command in re.split(r'\s&&\s', line):
                words = shlex.split(command, comments=True)
                if words:
                    yield f'{document.name}:{start}', words


def known_commands():
    """Return the commands of `multicontact` by their names, as typer has them."""
    known = {}
    for name, command in typer.main.get_command(app).commands.items():
        inner = getattr(command, 'commands', None)
        if not inner:
            known[name] = command
            continue
        for key, inner_command in inner.items():
            known[f'{name} {key}'] = inner_command
    return known


def name_of(words):
    """Return the name of a command, which is two words for `topic`, and the words after it."""
    size = 1
    if words[1:2] == ['topic']:
        size = 2
    return ' '.join(words[1 : 1 + size]), words[1 + size :]


def parse(words):
    """Parse a command; files, scenario, robot, plant, preset, settings and study are there."""
    if words[1].startswith('--'):
        assert words[1] in ('--help', '--version', '--install-completion')
        return
    name, arguments = name_of(words)
    for word in set(words[2:]) - YOURS:
        if re.fullmatch(r'[\w./-]+\.(yaml|urdf|json)|config/[\w./-]+', word):
            assert (ROOT / word).exists() or word.startswith('runs/'), word
    values = known_commands()[name].make_context(name, arguments).params
    if name == 'study' and values['name']:
        choices = read_choices(values['settings'] or ())
        apply_choices(read_study(values['name']), choices)
    if 'scenario' not in values or values.get('external') or values['robot'] in YOURS:
        return
    if has_urdf(values['robot'] or 'puma'):
        names = {field.name for field in fields(RunOptions)} & values.keys()
        RunOptions(**{name: values[name] for name in names}).setup()


def make(words):
    makefile = (ROOT / 'Makefile').read_text(encoding='utf-8')
    for target in words[1:]:
        is_variable = '=' in target
        assert is_variable or re.search(rf'^{target}:', makefile, re.MULTILINE), target


@pytest.mark.parametrize(
    'words',
    [
        pytest.param(words, id=f'{where} {" ".join(words)}')
        for document in DOCUMENTS
        for where, words in commands(document)
    ],
)
def test_command_is_one_that_there_is(words):
    if words[0] == 'multicontact':
        parse(words)
    elif words[0] == 'make':
        make(words)
    else:
        assert ' '.join(words).startswith(OTHERS)


NATIVE = re.compile(r'native\s+ROS 2|installation')


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_command_that_the_wheels_lack_says_where_it_is_from(document):
    """In its own paragraph or, of a block, in the one before it."""
    paragraphs = re.split(r'\n\s*\n', document.read_text(encoding='utf-8'))
    for before, text in zip(['', *paragraphs], paragraphs):
        if re.search(r'(^|[`# ])ros2 [a-z]', text, re.MULTILINE):
            assert NATIVE.search(before + text), text


OTHER_OPTIONS = {
    '--version',
    '--install-completion',
    '--autostart',
    '--ros-args',
    '--params-file',
}


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_options_in_the_text_are_those_of_commands(document):
    """Of `command --option` that command's, of `--option` alone those of any."""
    known = {}
    for name, command in known_commands().items():
        known[name] = {'--help'}
        for parameter in command.params:
            known[name].update(parameter.opts)
    every = OTHER_OPTIONS.union(*known.values())
    for span in re.findall(r'(?<!`)`([^`]+)`(?!`)', prose(document)):
        words = span.split()
        if words[0] == 'make':
            make(shlex.split(span))
        elif words[0] == 'multicontact' and words[1:2] != ['COMMAND']:
            name, arguments = name_of(words)
            assert name in known or not name or name.startswith('-'), span
            words = [name, *arguments]
        if words[0] in known or words[0].startswith('--'):
            asked = {word.split('=')[0] for word in words if word.startswith('--')}
            assert asked <= known.get(words[0], every), span


@pytest.mark.parametrize(
    'program',
    [
        pytest.param(text, id=f'{document.name}:{line}')
        for document in DOCUMENTS
        for line, text in blocks(document, 'python')
    ],
)
def test_program_names_what_there_is(program):
    """It compiles, its imports are there, and the client's methods take what they are given."""
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            exec(compile(ast.Module([node], []), 'imports', 'exec'), {})
        elif isinstance(node, ast.Call) and ast.unparse(node.func).startswith('arm.'):
            method = getattr(MultiContactClient, node.func.attr)
            keywords = {keyword.arg: keyword.value for keyword in node.keywords}
            inspect.signature(method).bind(None, *node.args, **keywords)
        elif isinstance(node, ast.Attribute) and ast.unparse(node.value) == 'state':
            assert node.attr in ArmState.__dataclass_fields__, node.attr


# It would install, change the shell, wait for a browser, or start a graph; instead of the graph's
# there is a bag of the first run.
NOT_FOLLOWED = (
    'make',
    '. ',
    'multicontact view',
    'multicontact run',
    'multicontact report runs/graph',
)


def forces_of(run):
    """Yield messages of the measured forces of a run."""
    for time, forces in zip(run.data.time[::10], run.data.alpha_meas[::10]):
        stamp = round(time * 1e9)
        names = run.data.contact_names
        message = messages.joint_state_message(stamp, names, effort=forces)
        yield topics.MEASURED_FORCES, stamp, message


def outline(text):
    """Return the words of a text without its numbers, which belong to a processor."""
    return ' '.join(re.sub(r'[-+]?\d[\d.e+-]*', '#', text).split())


@pytest.mark.nightly
def test_tutorial_can_be_followed(tmp_path, monkeypatch, capsys):
    """Line by line and program by program, with the exit codes and the words that it quotes."""
    monkeypatch.chdir(tmp_path)
    text = TUTORIAL.read_text(encoding='utf-8')
    output = ''
    followed = 0
    for language, block in re.findall(
        r'^```(\w+)\n(.*?)^```$', text, re.MULTILINE | re.DOTALL
    ):
        capsys.readouterr()
        if language == 'python':
            exec(compile(block, str(TUTORIAL), 'exec'), {'__name__': '__main__'})
            output = capsys.readouterr().out
            followed = followed + 1
        elif language == 'sh':
            for line in lines_of(block):
                words = shlex.split(line, comments=True)
                if words[:2] == ['multicontact', 'run']:
                    folder = Path(words[words.index('--out') + 1])
                    folder.mkdir(parents=True)
                    write_bag(folder / 'bag', forces_of(load_run(FIRST)))
                if not line.startswith(NOT_FOLLOWED):
                    with pytest.raises(SystemExit) as end:
                        app(words[1:], prog_name='multicontact')
                    assert end.value.code == int('exit code 1' in line), line
                    followed += 1
            output = capsys.readouterr().out
        elif language == 'text' and output:
            for line in block.splitlines():
                assert outline(line) in outline(output), line
    assert followed >= 6
