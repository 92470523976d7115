"""
Every command and program in the documents is one that can be given as it stands there.

Of each ```sh block all lines are taken, `&&` and continued lines included. HOW says what is done
with a line, by its beginning: the longest that fits counts, and a line that none fits is an error.
The tutorial is followed for real, in one folder from its first line to its last; NOT_FOLLOWED says
what of it is not.
"""

import ast
from functools import wraps
import inspect
from pathlib import Path
import re
import runpy
import shlex
import sys

from multicontact_control import cli
from multicontact_control.cli.options import resolve_settings
from multicontact_control.client import ArmState, MultiContactClient
from multicontact_control.errors import MulticontactError
from multicontact_control.experiment.results import load_run
from multicontact_control.experiment.study.presets.sweep.config import study_path
from multicontact_control.nodes import messages, topics
from multicontact_control.nodes.bag import Bag
from packaging.requirements import Requirement
import pytest
from rclpy.serialization import serialize_message
from ros_graph import ROOT
import setuptools
import typer
from typer.testing import CliRunner

DOCUMENTS = [ROOT / 'README.md', ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md'))]
TUTORIAL, FIRST = ROOT / 'docs/tutorial.md', Path('runs/first')

# Files in a line that are the reader's own, or made by one that is not of this package.
YOURS = {
    'arm.urdf', 'my_arm.urdf', 'my_arm.yaml', 'controller.yaml', 'tool.yaml', 'BAG', 'bag',
    'tsid/bin/python', 'robot/bin/activate', '.venv/bin/activate'}
# Recordings are not looked for: only the tutorial makes any. Nor is what a command writes.
RECORDINGS = re.compile(r'runs/[\w-]+$')
WRITTEN = {'out', 'output', 'screenshot'}


def blocks(document, language):
    """Return the blocks of a language in a document: line, text."""
    text = document.read_text(encoding='utf-8')
    return [(text[:found.start()].count('\n') + 1, found[1]) for found in re.finditer(
        rf'^```{language}\n(.*?)^```$', text, re.MULTILINE | re.DOTALL)]


def lines(document):
    """Return the commands of a document: the block it stands in, its words."""
    found = []
    for start, block in blocks(document, 'sh'):
        for line in continued(block):
            words = shlex.split(line, comments=True)
            while words:
                end = words.index('&&') if '&&' in words else len(words)
                found.append((f'{document.name}:{start}', words[:end]))
                words = words[end + 1:]
    return found


def continued(block):
    """Return the lines of a block, each with those that it goes on in."""
    return re.sub(r'\\\n\s*', ' ', block).splitlines()


@pytest.fixture(name='parse', scope='module')
def fixture_parse():
    """Return what parses the words after `multicontact` with typer, without the bodies."""
    parsed = []
    parser = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

    def without_body(name, body):
        @wraps(body)
        def take(**values):
            parsed.append((name, values))
        return take

    for info in cli.app.registered_commands:
        name = info.name or info.callback.__name__.replace('_', '-')
        parser.command(name)(without_body(name, info.callback))

    def parse(words):
        parsed.clear()
        with pytest.raises(SystemExit) as end:
            parser(words, prog_name='multicontact')
        return end.value.code, *(parsed[0] if parsed else (words[0], {}))
    return parse


@pytest.fixture(name='described', scope='module')
def fixture_described():
    """Return what setup.py hands to setuptools."""
    received = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        patch.setattr(sys, 'argv', ['setup.py', 'egg_info'])
        patch.setattr(setuptools, 'setup', lambda **keywords: received.update(keywords))
        runpy.run_path(str(ROOT / 'setup.py'))
    return received


def parses(words, parse, **_):
    """All of its options are there, and take what they are given; files that it reads, too."""
    code, _, values = parse(words[1:])
    assert code == 0
    for name, value in values.items():
        for path in value if isinstance(value, list) and name not in WRITTEN else ():
            check_file(path)
        if name not in WRITTEN and str(value) in words:
            check_file(value)


def check_file(path):
    """Find a file that is named, if that is what it is."""
    if isinstance(path, Path) and str(path) not in YOURS and not RECORDINGS.match(str(path)):
        assert (ROOT / path).exists(), path


def resolves(words, parse, **_):
    """As `parses`; and scenario, robot, plant, preset and settings make a configuration."""
    parses(words, parse)
    values = parse(words[1:])[2]
    options = {key: values.get(key) or '' for key in ('plant', 'robot', 'preset')}
    if values.get('external') or options['robot'] in YOURS:
        return
    resolve_settings(values['scenario'], {
        **options, 'seed': values['seed'],
        'noise_estimator': {'estimator': values['noise_estimator']} if values.get(
            'noise_estimator') else None,
        'controller': {'force': {'law': values['law']}} if values.get('law') else None,
        'plant_overrides': {'engine': values['engine']} if values.get('engine') else None,
    }, values.get('settings'))


def names_a_study(words, parse, **_):
    """As `parses`; and there is such a study."""
    parses(words, parse)
    study_path(parse(words[1:])[2]['study'])


def asks_for_help(words, parse, **_):
    assert parse(words[1:])[0] == 0


def offers_completion(words, **_):
    """Read it in what the program says of itself: it would change the reader's shell."""
    assert words[1] in CliRunner().invoke(cli.app, ['--help'], env={'COLUMNS': '200'}).output


def makes(words, **_):
    """There is such a target."""
    makefile = (ROOT / 'Makefile').read_text(encoding='utf-8')
    for target in words[1:]:
        if '=' not in target:
            assert re.search(rf'^{target}:', makefile, re.MULTILINE), target


def installs(words, described, **_):
    """Find the extras of this package; what else is named is of others."""
    for word in words[2:]:
        found = re.fullmatch(r'(?:\.|multicontact_control)\[(.+)\]', word)
        for extra in found[1].split(',') if found else ():
            assert extra in described['extras_require'], word
        if not found and not word.startswith(('-', '.')):
            Requirement(word)


def is_of_others(**_):
    """Nothing is known of it here."""


HOW = {
    'multicontact': parses,
    'multicontact --help': asks_for_help,
    'multicontact --install-completion': offers_completion,
    'multicontact simulate': resolves,
    'multicontact run': resolves,
    'multicontact view': resolves,
    'multicontact sweep': names_a_study,
    'make': makes,
    'pip install': installs,
    'tsid/bin/pip install': is_of_others,
    'python3 -m venv': is_of_others,
    '. ': is_of_others,
    'cp': is_of_others,
    'dask': is_of_others,
    'ros2 bag play': is_of_others,
    'ros2 launch foxglove_bridge': is_of_others,
    'ros2 run robot_state_publisher': is_of_others,
    'ros2 run tf2_ros': is_of_others,
}


def how(words):
    """Return what is to be done with a line."""
    line = ' '.join(words)
    fitting = [start for start in HOW if f'{line} '.startswith(f'{start.strip()} ')]
    assert fitting, f'nothing is known of {line}'
    return HOW[max(fitting, key=len)]


@pytest.mark.parametrize(
    ('words'), [pytest.param(words, id=f'{where} {" ".join(words)}')
                for document in DOCUMENTS for where, words in lines(document)])
def test_command_is_one_that_there_is(words, parse, described):
    how(words)(words=words, parse=parse, described=described)


def test_stale_commands_are_found(parse, described):
    """An option, a target, an extra or a value that is not there any more."""
    for words in ('multicontact simulate --gone', 'multicontact gone', 'make gone',
                  "pip install '.[gone]'", 'multicontact sweep gone',
                  'multicontact simulate --scenario gone', 'multicontact run --preset gone',
                  'multicontact simulate --set controller.force.gone=1',
                  'multicontact report gone/run', 'multicontact design --noise much', 'gone'):
        words = shlex.split(words)
        with pytest.raises((AssertionError, MulticontactError)):
            how(words)(words=words, parse=parse, described=described)


# Options in the text that are not those of a command of ours.
NODE_OPTIONS = {'--autostart', '--ros-args', '--params-file'}


@pytest.mark.parametrize('document', DOCUMENTS, ids=lambda path: path.name)
def test_options_in_the_text_are_those_of_commands(document, described):
    """Of `command --option` that command's, of `--option` alone those of any."""
    known = {name: {option for x in command.params for option in x.opts}
             for name, command in typer.main.get_command(cli.app).commands.items()}
    every = set().union(*known.values(), NODE_OPTIONS, {'--help', '--version'})
    nodes = {line.split(' = ')[0] for line in described['entry_points']['console_scripts']}
    text = re.sub(r'^```.*?^```$', '', document.read_text(encoding='utf-8'),
                  flags=re.MULTILINE | re.DOTALL)
    for span in re.findall(r'(?<!`)`([^`]+)`(?!`)', text):
        words = span.replace('\n', ' ').removeprefix('multicontact ').split()
        if span.startswith('make '):
            makes(shlex.split(span))
            continue
        if words[:2] == ['ros2', 'run']:
            assert words[2] == 'multicontact_control' and words[3] in nodes, span
            assert all((ROOT / x).is_file() for x in words if x.endswith('.yaml')), span
        of = known.get(words[0], every) | {'--help'} if words else every
        if span.startswith('multicontact ') and words[0] != 'COMMAND':
            assert words[0] in known or words[0].startswith('-'), span
        asked = {word.split('=')[0] for word in words if word.startswith('--')}
        if words and (words[0] in known or words[0].startswith('--') or words[0] in nodes):
            assert asked <= of, f'{span}: {asked - of}'


PROGRAMS = [pytest.param(text, id=f'{document.name}:{line}')
            for document in DOCUMENTS for line, text in blocks(document, 'python')]


@pytest.mark.parametrize('program', PROGRAMS)
def test_program_names_what_there_is(program):
    """It compiles, its imports are there, and the client's methods take what they are given."""
    tree = ast.parse(program)
    for node in ast.walk(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            exec(compile(ast.Module([node], []), 'imports', 'exec'), {})
        elif (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)
                and isinstance(node.func.value, ast.Name) and node.func.value.id == 'arm'):
            inspect.signature(getattr(MultiContactClient, node.func.attr)).bind(
                None, *node.args, **{x.arg: x.value for x in node.keywords})
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and (
                node.value.id == 'state'):
            assert node.attr in ArmState.__dataclass_fields__, node.attr


# What of the tutorial is not done, and why.
NOT_FOLLOWED = {
    'make': 'it would install',
    '. ': 'it would change the shell',
    'multicontact view': 'it waits for a browser; test/view/ follows it',
    'multicontact run': 'it takes processes; a bag of the first run stands where its own would',
    'multicontact report runs/graph': 'of that there is no more than this bag'}


def write_bag(folder, run):
    """Write the measured forces of a run as the recorder does."""
    topic = topics.MEASURED_FORCES
    with Bag(folder) as writer:
        writer.add_topic(f'/{topic.name}', topic.type_name, topic.profile)
        for time, forces in zip(run.data.time[::10], run.data.alpha_meas[::10]):
            stamp = round(time * 1e9)
            message = messages.joint_state_message(stamp, run.data.contact_names, effort=forces)
            writer.write(f'/{topic.name}', serialize_message(message), stamp)


@pytest.mark.slow
def test_tutorial_can_be_followed(tmp_path, monkeypatch, capsys):
    """Line by line and program by program, with the exit codes and the words that it tells."""
    monkeypatch.chdir(tmp_path)
    text = TUTORIAL.read_text(encoding='utf-8')
    said, followed = '', 0
    for language, block in re.findall(r'^```(\w+)\n(.*?)^```$', text, re.MULTILINE | re.DOTALL):
        if language == 'python':
            capsys.readouterr()
            exec(compile(block, str(TUTORIAL), 'exec'), {'__name__': '__main__'})
            said, followed = capsys.readouterr().out, followed + 1
        elif language == 'sh':
            said = ''
            for line in continued(block):
                words = shlex.split(line, comments=True)
                if any(line.startswith(start) for start in NOT_FOLLOWED):
                    if words[:2] == ['multicontact', 'run']:
                        write_bag(Path(words[words.index('--out') + 1]) / 'bag', load_run(FIRST))
                    continue
                capsys.readouterr()
                with pytest.raises(SystemExit) as end:
                    cli.app(words[1:], prog_name='multicontact')
                assert end.value.code == int('exit code 1' in line), line
                said, followed = said + capsys.readouterr().out, followed + 1
        elif language == 'text' and said:
            for line in block.splitlines():
                assert outline(line) in outline(said), line
    assert followed >= 6


def outline(text):
    """Return the words of a text without its numbers, which belong to a processor."""
    return ' '.join(re.sub(r'[-+]?\d[\d.e+-]*', '#', text).split())
