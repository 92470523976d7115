"""
Write docs/reference from what the code declares: parameters, topics, services, commands.

`make reference` runs it. The pages are checked in, so that they can be read where nothing is
installed; test/test_reference.py says when they have to be made again.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator, Sequence
import inspect
from itertools import pairwise
import json
from pathlib import Path
import re
import textwrap
from types import NoneType, UnionType
import typing
from typing import Any, Literal, NamedTuple, Union

from multicontact_control.choices import NameIn
from multicontact_control.cli.application import app, FOLDERS
from multicontact_control.cli.options import describe_files
from multicontact_control.config import Config, ControllerConfig, NoiseEstimatorConfig
from multicontact_control.config.base import list_kinds
from multicontact_control.faults.situation import SituationConfig
from multicontact_control.learning.config import EnvironmentConfig
from multicontact_control.nodes import qos, topics
from multicontact_control.nodes.controller_node import ControllerNodeConfig
from multicontact_control.nodes.controller_topics import SERVICES
from multicontact_control.nodes.franka_bridge import FrankaBridgeConfig
from multicontact_control.nodes.graph import StartupConfig
from multicontact_control.nodes.recorder_node import RecorderConfig
from multicontact_control.runs.scenario import ScenarioConfig
from multicontact_control.study.config import StudyConfig
from pydantic.fields import FieldInfo
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sim_bridge.config import PlantConfig
from sim_bridge.robot_file import RobotFile
from sim_bridge.sim_node import SimNodeConfig
import typer

FOLDER = Path(__file__).resolve().parent / 'reference'
MADE = '<!-- Made by docs/make_reference.py: `make reference` writes it anew. -->'
WIDTH = 116  # of a line of prose

# What is declared, by the node that has it as parameters, in the order of the page.
NODES: dict[str, tuple[type[Config], ...]] = {
    topics.CONTROLLER: (ControllerConfig, ControllerNodeConfig),
    topics.ESTIMATOR: (NoiseEstimatorConfig,),
    topics.SIM: (PlantConfig, SimNodeConfig),
    topics.RECORDER: (RecorderConfig,),
    'franka_bridge': (FrankaBridgeConfig,),
    topics.EVERY_NODE: (StartupConfig,),
}
# And by the YAML file that holds it.
FILES: dict[str, tuple[str, type[Config]]] = {
    'scenario': ('`config/scenarios`, and `--scenario FILE`', ScenarioConfig),
    'robot': ('`config/robots`, and `--robot FILE`', RobotFile),
    'study': ('`config/studies`, and `multicontact study FILE`', StudyConfig),
    'situation': ('`situation.*` of `config/studies/situations.yaml`', SituationConfig),
    'environment': ('`gymnasium.make`, `docs/learning.md`', EnvironmentConfig),
}
TYPES = {bool: 'bool', int: 'int', float: 'float', str: 'string', Any: 'any'}
VALUES = {bool: '', int: 'INTEGER', float: 'NUMBER', str: 'TEXT', Path: 'PATH'}
BOUNDS = {  # of pydantic, and how they are written
    'gt': '> ',
    'ge': '≥ ',
    'lt': '< ',
    'le': '≤ ',
    'min_length': 'at least ',
    'max_length': 'at most ',
}
EMPTY_TEXT = '""'


class Entry(NamedTuple):
    """
    A value that can be set, as a row of a table shows it.

    Its kind is the name of its type on the pages, such as `float[3]`; it has choices if it is one
    of a few texts.
    """

    name: str
    kind: str
    field: FieldInfo
    choices: Sequence[str]

    @property
    def unit(self) -> str:
        """
        Return the SI unit that it was declared with, empty if it has none.

        Parameters state it beside their description, where `parameter(..., unit=...)` declares
        them.
        """
        return str(_declared_extra(self.field).get('unit', ''))

    @property
    def live(self) -> bool:
        """
        Whether it may change while a node runs; all others while it is unconfigured.

        The controller blends from the old torque to the new one then, as `transition` says.
        """
        return bool(_declared_extra(self.field).get('live'))

    @property
    def default(self) -> str:
        """
        Return the default as YAML has it, or that there is none.

        JSON is YAML, too, so that a reader can copy it into a file.
        """
        if self.field.is_required():
            return 'required'
        value = self.field.get_default(call_default_factory=True)
        return f'`{json.dumps(_plain_value(value))}`'

    @property
    def limits(self) -> str:
        """Return the range or the choices, as Markdown; empty if its type alone limits it."""
        if self.choices:
            return ', '.join(f'`{choice or EMPTY_TEXT}`' for choice in self.choices)
        limits = []
        for name, words in BOUNDS.items():
            for bound in self.field.metadata:
                value = getattr(bound, name, None)
                if value is not None:
                    limits.append(f'{words}{value:g}')
        return ', '.join(limits)


class Group(NamedTuple):
    """
    The values that one model declares itself, under the dotted prefix of their names.

    A page has a heading and a table for each; what it holds of other models is in groups of their
    own.
    """

    prefix: str
    model: type[Config]
    entries: Sequence[Entry]


def list_groups(model: type[Config], prefix: str = '') -> Iterator[Group]:
    """
    Yield the values of a model and then those of the models in it, however deep.

    In a prefix NAME stands for any key of a mapping, N for a place in a list. What a model
    inherits from another one, as those of nodes do, is listed with that one alone.
    """
    entries = []
    inner = []
    inherited: set[str] = set()
    for base in model.__mro__[1:]:
        inherited.update(getattr(base, 'model_fields', ()))
    for key, field in model.model_fields.items():
        if key in inherited:
            continue
        name = prefix + key
        kinds = list(list_kinds(field.annotation))
        if len(kinds) > 1:
            for _, each in kinds:
                inner.append((each, f'{name}.'))
            continue
        kind = _bare_type(field.annotation)
        origin = typing.get_origin(kind)
        arguments = [_bare_type(each) for each in typing.get_args(kind)]
        if _is_config(kind):
            inner.append((kind, f'{name}.'))
        elif origin is dict and _is_config(arguments[1]):
            inner.append((arguments[1], f'{name}.NAME.'))
        elif origin is tuple and _is_config(arguments[0]):
            inner.append((arguments[0], f'{name}.N.'))
        else:
            choices = [*_list_names(field), *_list_choices(kind)]
            entries.append(Entry(name, _name_type(kind), field, choices))
    heading = prefix.rstrip('.')
    for kind, _ in list_kinds(model):
        heading = f'{heading} ({kind})'
    yield Group(heading, model, entries)
    for child, child_prefix in inner:
        yield from list_groups(child, child_prefix)


def _name_type(kind: Any) -> str:
    """Return what a type is called on the pages."""
    origin = typing.get_origin(kind)
    arguments = typing.get_args(kind)
    if origin is Literal:
        return 'string'
    if origin is dict:
        return f'{_name_type(_bare_type(arguments[1]))} by name'
    if origin is tuple:
        size = '' if arguments[-1] is Ellipsis else len(arguments)
        return f'{_name_type(_bare_type(arguments[0]))}[{size}]'
    return TYPES[kind]


def _list_names(field: FieldInfo) -> Iterator[str]:
    """Yield the names of the registry that a text is one of."""
    for mark in field.metadata:
        if isinstance(mark, NameIn):
            yield from mark.names


def _list_choices(kind: Any) -> list[str]:
    """Return the values that a type, or each part of a list, chooses from; none if it is free."""
    origin = typing.get_origin(kind)
    arguments = typing.get_args(kind)
    if origin is tuple:
        return _list_choices(_bare_type(arguments[0]))
    if origin is not Literal:
        return []
    choices = []
    for argument in arguments:
        choices += _list_choices(argument) or [argument]
    return choices


def _bare_type(annotation: Any) -> Any:
    """Return a type without what pydantic checks, and without None."""
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        return _bare_type(typing.get_args(annotation)[0])
    if origin in (Union, UnionType):
        first = next(x for x in typing.get_args(annotation) if x is not NoneType)
        return _bare_type(first)
    return annotation


def _is_config(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Config)


def _declared_extra(field: FieldInfo) -> dict[str, Any]:
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


def _plain_value(value: Any) -> Any:
    """Return a default as JSON has it."""
    if isinstance(value, Config):
        return value.model_dump(mode='json')
    if isinstance(value, dict):
        return {key: _plain_value(entry) for key, entry in value.items()}
    if isinstance(value, (tuple, list)):
        return [_plain_value(entry) for entry in value]
    return value


def make_parameters_page() -> str:
    """
    Return the page of all parameters: those of nodes, then those of files.

    A table has the name, type, default, unit, range and description that the code declares.
    """
    parts = [
        '# Parameters',
        MADE,
        'Every value that can be set, as it is declared in the code: `ros2 param describe` says '
        'the same of a node that runs. In a parameter file dots are levels of the YAML; on the '
        'command line, `--set controller.force.damping_rate=60` (or `noise_estimator.`, '
        '`plant.`, `scenario.`) of `run`, `simulate` and `view` takes the same names, and `*` for '
        'every NAME. What only a node needs to know is for `run` and `view`, which start nodes. '
        'NAME is one of `contact_names`. All units are SI. *Live* values change while the node '
        'runs, all others while it is unconfigured.',
    ]
    for node, models in NODES.items():
        parts.append(f'## {node}')
        for model in models:
            parts += _group_tables(node, model, live=True)
    for name, (where, model) in FILES.items():
        parts += [
            f'## {name} file',
            f'In {where}.',
            *_group_tables(f'{name} file', model),
        ]
    return _join_page(parts)


def _group_tables(
    title: str, model: type[Config], *, live: bool = False
) -> Iterator[str]:
    """Yield a table for each model with values of its own; `live` adds a column."""
    header = ['parameter', 'type', 'default', 'unit', 'range', 'what it is']
    if live:
        header.insert(-1, 'live')
    for group in list_groups(model):
        if not group.entries:
            continue
        if group.prefix:
            yield f'### {title}: {group.prefix}'
        yield _escape_text(group.model.__doc__)
        rows = []
        for entry in group.entries:
            row = [
                f'`{entry.name}`',
                entry.kind,
                entry.default,
                _escape_text(entry.unit),
                entry.limits,
                _escape_text(entry.field.description),
            ]
            if live:
                row.insert(-1, 'yes' if entry.live else '')
            rows.append(row)
        yield make_table(header, rows)


def make_topics_page() -> str:
    """
    Return the page of topics, services and qualities of service.

    Topics and services come from their declarations, profiles from the constants of `nodes/qos`
    and the texts below these.
    """
    # Equal profiles have different reasons: each is known by its identity.
    profile_names = {}
    profiles = []
    for name, text in _constant_docs(qos).items():
        profile = getattr(qos, name)
        profile_names[id(profile)] = name
        profiles.append([f'`{name}`', *_policies(profile), _escape_text(text)])
    contents = []
    ends = []
    for topic in topics.TOPICS:
        contents.append(
            [f'`{topic.name}`', topic.type_name, _escape_text(topic.content)]
        )
        ends.append(
            [
                f'`{topic.name}`',
                topic.publisher,
                ', '.join(topic.subscribers),
                topic.rate,
                f'[{profile_names[id(topic.profile)]}](#quality-of-service)',
            ]
        )
    services = []
    for name, (kind, content) in SERVICES.items():
        package = kind.__module__.split('.')[0]
        type_name = f'{package}/srv/{kind.__name__}'
        services.append([f'`~/{name}`', type_name, _escape_text(content)])
    return _join_page(
        [
            '# Topics and services',
            MADE,
            'All names but those with a slash in front are relative: a namespace moves the whole '
            'graph. The robot, or a simulator of yours, stands where `sim_node` does. '
            '*control*: one message per control period; *event*: now and then. What '
            'each end does when messages are late, missing or wrong is in '
            '[the interface](../interface.md#samples).',
            '## Topics',
            make_table(['topic', 'type', 'content'], contents),
            '## Ends',
            f'`{topics.RECORDER}` reads all of them.',
            make_table(
                ['topic', 'from', 'always read by', 'rate', 'published as'], ends
            ),
            'The controller also reads one of the two wrenches (`wrench_input`; none with '
            '`momentum`) and the commands, which it refuses while it follows a scenario; with '
            '`effort_output_topic` it publishes bare efforts, too '
            '(std_msgs/msg/Float64MultiArray). '
            'Estimators that work on innovations read `contact_forces/innovation`.',
            '## Services',
            f'Of `{topics.CONTROLLER}`; each answers with `success`, and with words or the reason '
            'of a refusal. Controller and noise estimator also have those of every '
            'life-cycle node (`~/change_state`, `~/get_state`), and every node but '
            'the recorder those of parameters.',
            make_table(['service', 'type', 'what it does'], services),
            '## Quality of service',
            'History is `KEEP_LAST` throughout. An end that cannot be served is logged with its '
            'node, topic and policy.',
            make_table(
                ['profile', 'reliability', 'depth', 'durability', 'for'], profiles
            ),
        ]
    )


def _policies(profile: QoSProfile) -> list[str]:
    """Return reliability, depth and durability in words."""
    reliability = 'best effort'
    if profile.reliability == ReliabilityPolicy.RELIABLE:
        reliability = 'reliable'
    durability = 'volatile'
    if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
        durability = 'transient local'
    return [reliability, str(profile.depth), durability]


def _constant_docs(module: Any) -> dict[str, str]:
    """Return the strings that stand below the constants of a module, by their names."""
    docs = {}
    for first, second in pairwise(ast.parse(inspect.getsource(module)).body):
        if isinstance(first, ast.Assign) and isinstance(second, ast.Expr):
            target = first.targets[0]
            text = second.value
            if isinstance(target, ast.Name) and isinstance(text, ast.Constant):
                docs[target.id] = inspect.cleandoc(str(text.value))
    return docs


def make_commands_page() -> str:
    """
    Return the page of all commands and their options, and of the files that these choose from.

    Commands stand in the order of the help; a hidden one is left out.
    """
    commands = dict(_list_commands(app))
    overview = []
    for name, command in commands.items():
        link = f'[`{name}`](#multicontact-{name.replace(" ", "-")})'
        first_paragraph = command.help.split('\n\n')[0]
        overview.append([link, _escape_text(first_paragraph)])
    parts = [
        '# Commands',
        MADE,
        'What `multicontact COMMAND --help` says, of all commands at once. Exit codes: 0 stable, '
        'or not judged, or done; 1 not stable, held by the supervisor, a node died, or what was '
        'asked for failed; 2 bad input; 128 + n ended by signal n.',
        make_table(['command', 'what it does'], overview),
    ]
    for name, command in commands.items():
        parts += _command_section(name, command)
    for folder in dict.fromkeys(FOLDERS.values()):
        files = [
            [f'`{name}`', _escape_text(text)]
            for name, text in describe_files(folder).items()
        ]
        parts += [
            f'## {folder.capitalize()} by name',
            make_table(['name', 'what it is'], files),
        ]
    return _join_page(parts)


def _command_section(name: str, command: Any) -> Iterator[str]:
    """Yield heading, usage, help, arguments and options of a command."""
    kinds = typing.get_type_hints(command.callback)
    usage = ['multicontact', name]
    arguments = []
    options = []
    for parameter in command.params:
        text = _escape_text(parameter.help)
        if parameter.param_type_name == 'argument':
            arguments.append([f'`{_metavar(parameter)}`', text])
            usage.append(_metavar(parameter))
        else:
            names = [*parameter.opts, *parameter.secondary_opts]
            options.append(
                [
                    ', '.join(f'`{each}`' for each in names),
                    _option_value(parameter, kinds[parameter.name]),
                    _option_default(parameter),
                    text,
                ]
            )
    if options:
        usage.insert(2, '[OPTIONS]')
    yield f'## multicontact {name}'
    yield f'```\n{" ".join(usage)}\n```'
    for paragraph in inspect.cleandoc(command.help).split('\n\n'):
        yield _paragraph(paragraph)
    if arguments:
        yield make_table(['argument', 'what it is'], arguments)
    if options:
        yield make_table(['option', 'value', 'default', 'what it is'], options)


def _list_commands(application: typer.Typer) -> Iterator[tuple[str, Any]]:
    """Yield names and commands, those of groups behind the others; none that are hidden."""
    for name, command in typer.main.get_command(application).commands.items():  # type: ignore
        if command.hidden:
            continue
        if isinstance(command, typer.core.TyperGroup):
            for inner_name, inner in command.commands.items():
                yield f'{name} {inner_name}', inner
        else:
            yield name, command


def _paragraph(text: str) -> str:
    """Return a paragraph of a help text; what follows a line of backspace is an example."""
    if not text.startswith('\b'):
        return _escape_text(text)
    return '```yaml\n' + textwrap.dedent(text.removeprefix('\b\n')) + '\n```'


def _metavar(argument: Any) -> str:
    name = argument.metavar or argument.name.upper()
    if argument.nargs == -1:
        name += '...'
    return name if argument.required else f'[{name}]'


def _option_value(option: Any, kind: Any) -> str:
    """Return what an option takes; nothing if it is a flag."""
    if option.metavar:
        return _escape_text(option.metavar)
    kind = _bare_type(kind)
    if typing.get_origin(kind) is list:
        kind = _bare_type(typing.get_args(kind)[0])
    if typing.get_origin(kind) is Literal:
        return ', '.join(f'`{choice}`' for choice in typing.get_args(kind))
    return VALUES[kind]


def _option_default(option: Any) -> str:
    if isinstance(option.default, bool) or option.default in (None, '', (), []):
        return ''
    return f'`{option.default}`'


def make_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """
    Return a table of Markdown; what stands in its cells is Markdown, too.

    Line breaks in a cell become blanks, because a row is one line.
    """
    lines = []
    for row in (header, ['---'] * len(header), *rows):
        cells = [' '.join(cell.split()) for cell in row]
        lines.append(f'| {" | ".join(cells)} |')
    return '\n'.join(lines)


def _escape_text(text: str | None) -> str:
    """Return plain words of the code as Markdown: what is in backquotes stays as it is."""
    if text is None:
        return ''
    parts = ' '.join(text.split()).replace('``', '`').split('`')
    for i in range(0, len(parts), 2):
        parts[i] = re.sub(r'([*|<]|(?<!\w)_|_(?!\w))', r'\\\1', parts[i])
    return '`'.join(parts)


def _join_page(parts: Iterable[str]) -> str:
    """Return a page of parts, with its paragraphs in lines; tables and code stay as they are."""
    wrapped = []
    for part in parts:
        if not part.startswith(('|', '#', '<!--', '```')) and '\n' not in part:
            part = textwrap.fill(
                part, WIDTH, break_long_words=False, break_on_hyphens=False
            )
        wrapped.append(part)
    return '\n\n'.join(wrapped) + '\n'


PAGES: dict[str, Callable[[], str]] = {
    'parameters.md': make_parameters_page,
    'topics.md': make_topics_page,
    'commands.md': make_commands_page,
}


def main() -> None:
    """
    Write all pages anew into docs/reference, whose folder is made if it is not there.

    `test/test_reference.py` compares them with what the code declares, and fails if they differ.
    """
    FOLDER.mkdir(exist_ok=True)
    for name, page in PAGES.items():
        (FOLDER / name).write_text(page(), encoding='utf-8')


if __name__ == '__main__':
    main()
