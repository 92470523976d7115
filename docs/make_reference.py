"""
Write docs/reference from what the code declares: parameters, topics, services, commands.

`make reference` runs it. The pages are checked in, so that they can be read where nothing is
installed; test/test_reference.py says when they have to be made again.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator, Sequence
import inspect
import json
from pathlib import Path
import re
import textwrap
from types import NoneType, UnionType
import typing
from typing import Any, Literal, NamedTuple, Union

from multicontact_control.cli.application import app, FOLDERS
from multicontact_control.cli.options import described
from multicontact_control.config import Config, ControllerConfig, NoiseEstimatorConfig
from multicontact_control.faults.situation import SituationConfig
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
}
TYPES = {bool: 'bool', int: 'int', float: 'float', str: 'string', Any: 'any'}
VALUES = {bool: '', int: 'INTEGER', float: 'NUMBER', str: 'TEXT', Path: 'PATH'}
BOUNDS = {'gt': '> ', 'ge': '≥ ', 'lt': '< ', 'le': '≤ '}


class Entry(NamedTuple):
    """A value that can be set."""

    name: str
    kind: str
    field: FieldInfo
    choices: Sequence[str]

    @property
    def unit(self) -> str:
        """Return the declared SI unit."""
        return str(_extra(self.field).get('unit', ''))

    @property
    def live(self) -> bool:
        """Whether it may change while a node runs."""
        return bool(_extra(self.field).get('live'))

    @property
    def default(self) -> str:
        """Return the default as YAML has it, or that there is none."""
        if self.field.is_required():
            return 'required'
        value = self.field.get_default(call_default_factory=True)
        return f'`{json.dumps(_plain(value))}`'

    @property
    def limits(self) -> str:
        """Return the range or the choices."""
        if self.choices:
            return ', '.join(
                f'`{choice}`' if choice else '`""`' for choice in self.choices
            )
        bounds = [
            f'{sign}{getattr(bound, name):g}'
            for bound in self.field.metadata
            for name, sign in BOUNDS.items()
            if getattr(bound, name, None) is not None
        ]
        lengths = [
            f'{word} {count}'
            for bound in self.field.metadata
            for word, name in (('at least', 'min_length'), ('at most', 'max_length'))
            if (count := getattr(bound, name, None))
        ]
        return ', '.join(bounds + lengths)


class Group(NamedTuple):
    """The values that one model declares itself, under the prefix they have."""

    prefix: str
    model: type[Config]
    entries: Sequence[Entry]


def groups(model: type[Config], prefix: str = '') -> Iterator[Group]:
    """
    Yield a model and then those in it; NAME stands for any name, N for a place in a list.

    What a model has from another, as nodes do, is that one's.
    """
    entries, inner = [], []
    inherited = {
        key for base in model.__mro__[1:] for key in getattr(base, 'model_fields', ())
    }
    for key, field in model.model_fields.items():
        if key in inherited:
            continue
        kind, name = _bare(field.annotation), prefix + key
        origin, arguments = typing.get_origin(kind), typing.get_args(kind)
        if _is_config(kind):
            inner.append((kind, f'{name}.'))
        elif origin is dict and _is_config(_bare(arguments[1])):
            inner.append((_bare(arguments[1]), f'{name}.NAME.'))
        elif origin is tuple and _is_config(_bare(arguments[0])):
            inner.append((_bare(arguments[0]), f'{name}.N.'))
        else:
            entries.append(Entry(name, *_kind(kind, field)))
    yield Group(prefix.rstrip('.'), model, entries)
    for child, name in inner:
        yield from groups(child, name)


def _kind(kind: Any, field: FieldInfo) -> tuple[str, FieldInfo, Sequence[str]]:
    """Return what a value is called, with its field and its choices, if there are only a few."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is Literal:
        return (
            'string',
            field,
            [
                choice
                for x in arguments
                for choice in (
                    typing.get_args(x) if typing.get_origin(x) is Literal else (x,)
                )
            ],
        )
    if origin is dict:
        return f'{_kind(_bare(arguments[1]), field)[0]} by name', field, ()
    if origin is tuple:
        name, _, choices = _kind(_bare(arguments[0]), field)
        size = '' if arguments[-1] is Ellipsis else len(arguments)
        return f'{name}[{size}]', field, choices
    return TYPES[kind], field, ()


def _bare(annotation: Any) -> Any:
    """Return a type without what pydantic checks, and without None."""
    while typing.get_origin(annotation) is typing.Annotated:
        annotation = typing.get_args(annotation)[0]
    if typing.get_origin(annotation) in (Union, UnionType):
        rest = [x for x in typing.get_args(annotation) if x is not NoneType]
        return _bare(rest[0])
    return annotation


def _is_config(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Config)


def _extra(field: FieldInfo) -> dict[str, Any]:
    return field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}


def _plain(value: Any) -> Any:
    if isinstance(value, Config):
        return value.model_dump(mode='json')
    if isinstance(value, dict):
        return {key: _plain(x) for key, x in value.items()}
    return [_plain(x) for x in value] if isinstance(value, (tuple, list)) else value


def parameters() -> str:
    """Return the page of all parameters."""
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
        sections = [group for model in models for group in groups(model)]
        parts += [f'## {node}', *_group_tables(node, sections, live=True)]
    for name, (where, model) in FILES.items():
        parts += [
            f'## {name} file',
            f'In {where}.',
            *_group_tables(f'{name} file', list(groups(model))),
        ]
    return _page(parts)


def _group_tables(
    title: str, sections: Sequence[Group], *, live: bool = False
) -> Iterator[str]:
    header = [
        'parameter',
        'type',
        'default',
        'unit',
        'range',
        *(['live'] if live else ()),
        'what it is',
    ]
    for group in sections:
        if not group.entries:
            continue
        if group.prefix:
            yield f'### {title}: {group.prefix}'
        yield _text(group.model.__doc__)
        yield table(
            header,
            [
                [
                    f'`{x.name}`',
                    x.kind,
                    x.default,
                    _text(x.unit),
                    x.limits,
                    *([('yes' if x.live else '')] if live else ()),
                    _text(x.field.description),
                ]
                for x in group.entries
            ],
        )


def graph() -> str:
    """Return the page of topics, services and qualities of service."""
    names = _profile_names()
    contents = [[f'`{x.name}`', x.type_name, _text(x.content)] for x in topics.TOPICS]
    ends = [
        [
            f'`{x.name}`',
            x.publisher,
            ', '.join(x.subscribers),
            x.rate,
            f'[{names[id(x.profile)]}](#quality-of-service)',
        ]
        for x in topics.TOPICS
    ]
    described = _attribute_docs(qos)
    profiles = [
        [f'`{name}`', *_policies(getattr(qos, name)), _text(text)]
        for name, text in described.items()
    ]
    return _page(
        [
            '# Topics and services',
            MADE,
            'All names but those with a slash in front are relative: a namespace moves the whole '
            'graph. The robot, or a simulator of yours, stands where `sim_node` does. '
            '*control*: one message per control period; *event*: now and then. What '
            'each end does when messages are late, missing or wrong is in '
            '[the interface](../interface.md#samples).',
            '## Topics',
            table(['topic', 'type', 'content'], contents),
            '## Ends',
            f'`{topics.RECORDER}` reads all of them.',
            table(['topic', 'from', 'always read by', 'rate', 'published as'], ends),
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
            table(
                ['service', 'type', 'what it does'],
                [
                    [
                        f'`~/{name}`',
                        f'{kind.__module__.split(".")[0]}/srv/{kind.__name__}',
                        _text(content),
                    ]
                    for name, (kind, content) in SERVICES.items()
                ],
            ),
            '## Quality of service',
            'History is `KEEP_LAST` throughout. An end that cannot be served is logged with its '
            'node, topic and policy.',
            table(['profile', 'reliability', 'depth', 'durability', 'for'], profiles),
        ]
    )


def _policies(profile: QoSProfile) -> tuple[str, str, str]:
    return (
        'reliable'
        if profile.reliability == ReliabilityPolicy.RELIABLE
        else 'best effort',
        str(profile.depth),
        'transient local'
        if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        else 'volatile',
    )


def _profile_names() -> dict[int, str]:
    """Return what each profile is called, by its identity: equal ones have other reasons."""
    return {id(getattr(qos, name)): name for name in _attribute_docs(qos)}


def _attribute_docs(module: Any) -> dict[str, str]:
    """Return the strings that stand below the constants of a module, by their names."""
    body = ast.parse(inspect.getsource(module)).body
    return {
        first.targets[0].id: inspect.cleandoc(second.value.value)
        for first, second in zip(body, body[1:])
        if isinstance(first, ast.Assign)
        and isinstance(first.targets[0], ast.Name)
        and isinstance(second, ast.Expr)
        and isinstance(second.value, ast.Constant)
    }


def commands() -> str:
    """Return the page of all commands and their options."""
    known = dict(_commands(app))
    parts = [
        '# Commands',
        MADE,
        'What `multicontact COMMAND --help` says, of all commands at once. Exit codes: 0 stable, '
        'or not judged, or done; 1 not stable, held by the supervisor, a node died, or what was '
        'asked for failed; 2 bad input; 128 + n ended by signal n.',
        table(
            ['command', 'what it does'],
            [
                [
                    f'[`{name}`](#multicontact-{name.replace(" ", "-")})',
                    _text(_first(command.help)),
                ]
                for name, command in known.items()
            ],
        ),
    ]
    for name, command in known.items():
        kinds = typing.get_type_hints(command.callback)
        arguments = [x for x in command.params if x.param_type_name == 'argument']
        options = [x for x in command.params if x.param_type_name == 'option']
        usage = ' '.join(
            [
                'multicontact',
                name,
                *(['[OPTIONS]'] if options else ()),
                *(_metavar(x) for x in arguments),
            ]
        )
        parts += [
            f'## multicontact {name}',
            f'```\n{usage}\n```',
            *map(_paragraph, inspect.cleandoc(command.help).split('\n\n')),
        ]
        if arguments:
            parts.append(
                table(
                    ['argument', 'what it is'],
                    [[f'`{_metavar(x)}`', _text(x.help)] for x in arguments],
                )
            )
        if options:
            parts.append(
                table(
                    ['option', 'value', 'default', 'what it is'],
                    [
                        [
                            _names(x),
                            _value(x, kinds[x.name]),
                            _default(x),
                            _text(x.help),
                        ]
                        for x in options
                    ],
                )
            )
    for folder in dict.fromkeys(FOLDERS.values()):
        parts += [
            f'## {folder.capitalize()} by name',
            table(
                ['name', 'what it is'],
                [
                    [f'`{name}`', _text(text)]
                    for name, text in described(folder).items()
                ],
            ),
        ]
    return _page(parts)


def _commands(application: typer.Typer) -> Iterator[tuple[str, Any]]:
    """Yield names and commands, those of groups behind the others; none that are hidden."""
    for name, command in typer.main.get_command(application).commands.items():  # type: ignore
        inner = getattr(command, 'commands', None)
        if not command.hidden:
            yield from (
                ((f'{name} {key}', each) for key, each in inner.items())
                if inner
                else [(name, command)]
            )


def _paragraph(text: str) -> str:
    """Return a paragraph of a help text; what follows a line of backspace is an example."""
    if not text.startswith('\b'):
        return _text(text)
    return '```yaml\n' + textwrap.dedent(text.removeprefix('\b\n')) + '\n```'


def _metavar(argument: Any) -> str:
    name = (argument.metavar or argument.name.upper()) + '...' * (argument.nargs == -1)
    return name if argument.required else f'[{name}]'


def _names(option: Any) -> str:
    return ', '.join(f'`{name}`' for name in (*option.opts, *option.secondary_opts))


def _value(option: Any, kind: Any) -> str:
    """Return what an option takes; nothing if it is a flag."""
    if option.metavar:
        return _text(option.metavar)
    kind = _bare(kind)
    kind = _bare(typing.get_args(kind)[0]) if typing.get_origin(kind) is list else kind
    if typing.get_origin(kind) is Literal:
        return ', '.join(f'`{choice}`' for choice in typing.get_args(kind))
    return VALUES[kind]


def _default(option: Any) -> str:
    if isinstance(option.default, bool) or option.default in (None, '', (), []):
        return ''
    return f'`{getattr(option.default, "value", option.default)}`'


def _first(text: str) -> str:
    return text.split('\n\n')[0]


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of Markdown; what stands in its cells is Markdown, too."""
    lines = [header, ['---'] * len(header), *rows]
    return '\n'.join(
        f'| {" | ".join(" ".join(cell.split()) for cell in line)} |' for line in lines
    )


def _text(text: str | None) -> str:
    """Return plain words of the code as Markdown: what is in backquotes stays as it is."""
    parts = ' '.join((text or '').split()).replace('``', '`').split('`')
    for i in range(0, len(parts), 2):
        parts[i] = re.sub(r'([*|<]|(?<!\w)_|_(?!\w))', r'\\\1', parts[i])
    return '`'.join(parts)


def _page(parts: Iterable[str]) -> str:
    return '\n\n'.join(map(_wrapped, parts)) + '\n'


def _wrapped(part: str) -> str:
    """Return a paragraph in lines; tables, headings and code as they are."""
    if part.startswith(('|', '#', '<!--', '```')) or '\n' in part:
        return part
    lines, line = [], ''
    for word in part.split():
        if line and len(line) + 1 + len(word) > WIDTH:
            lines.append(line)
            line = word
        else:
            line = f'{line} {word}'.strip()
    return '\n'.join([*lines, line])


PAGES: dict[str, Callable[[], str]] = {
    'parameters.md': parameters,
    'topics.md': graph,
    'commands.md': commands,
}


def main() -> None:
    """Write the pages."""
    FOLDER.mkdir(exist_ok=True)
    for name, page in PAGES.items():
        (FOLDER / name).write_text(page(), encoding='utf-8')


if __name__ == '__main__':
    main()
