"""What every configuration is made of: declared parameters, their checks, and their files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import math
from pathlib import Path
import re
from typing import Annotated, Any, get_args, TypeVar

from multicontact_control.errors import ConfigError
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    model_validator,
    ValidationError,
    ValidationInfo,
)
import yaml

UNIT_NORM_TOLERANCE = 1e-3
ANY_NODE = '**'  # in the place of a node's name
LOADER = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)  # ten times as fast
# What pydantic puts around what it expects: the way it came there, and what it got.
PHRASES = re.compile(
    '^(Value error, (expected )?|Input should be |[A-Z][a-z]+ should have )'
    r'|( after validation)?, (not|unable|got a number) .*$'
)
KIND = 'kind'  # the key that says which of several models a mapping is
MAPPING = 'a mapping of keys to values'
KINDS = {'model_type': MAPPING, 'dict_type': MAPPING, 'tuple_type': 'a list of values'}


def _normalise(vector: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return a vector of unit length but for rounding; ValueError for another."""
    norm = math.sqrt(sum(x * x for x in vector))
    if not abs(norm - 1.0) <= UNIT_NORM_TOLERANCE:
        raise ValueError(
            f'expected a vector of unit length (within {UNIT_NORM_TOLERANCE}), length {norm:.6g}'
        )
    x, y, z = (component / norm for component in vector)
    return (x, y, z)


ModelT = TypeVar('ModelT', bound='Config')

Vector = tuple[float, ...]
PositiveVector = tuple[Annotated[float, Field(gt=0.0)], ...]
NonNegativeVector = tuple[Annotated[float, Field(ge=0.0)], ...]
Vector3 = tuple[float, float, float]
UnitVector3 = Annotated[Vector3, AfterValidator(_normalise)]


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = '',
    live: bool = False,
    **bounds: Any,
) -> Any:
    """
    Declare one tunable value as a pydantic field; a default of ``...`` makes it required.

    The description is one sentence without the SI unit. A live value may change while a node
    runs. Bounds are those of pydantic: ``gt``, ``ge``, ``lt``, ``le``, ``min_length``...
    """
    return Field(
        default,
        description=description,
        json_schema_extra={'unit': unit, 'live': live},
        **bounds,
    )


class Config(BaseModel):
    """
    Base of every configuration: a frozen model of declared parameters.

    Unknown keys, infinity and NaN are errors, and so is what `_cross_field_errors` yields.
    """

    model_config = ConfigDict(
        extra='forbid', frozen=True, validate_default=True, allow_inf_nan=False
    )

    def _cross_field_errors(self) -> Iterator[ConfigError]:
        """Yield an error for everything that does not fit together."""
        yield from ()

    @model_validator(mode='after')
    def _check(self, info: ValidationInfo) -> Config:
        """Let `validate` collect the errors of all models; a constructor raises its own."""
        errors = list(self._cross_field_errors())
        if info.context is not None:
            info.context.extend(errors)
        elif errors:
            raise ConfigError.combine(errors)
        return self


def validate(
    model: type[ModelT], values: Mapping[str, Any], source: str = ''
) -> ModelT:
    """
    Build a configuration from nested plain values, as a YAML file gives them.

    ConfigError has a line for every field that is not acceptable, with the file name `source`.
    Checks across fields run where each field has a value of its kind.
    """
    cross_field_errors: list[ConfigError] = []
    try:
        config = model.model_validate(values, context=cross_field_errors)
    except ValidationError as error:
        errors = []
        for detail in error.errors(include_url=False):
            errors.append(_field_error(detail, model))
        errors += cross_field_errors
        raise ConfigError.combine(errors, source) from None
    if cross_field_errors:
        raise ConfigError.combine(cross_field_errors, source)
    return config


def _field_error(detail: Mapping[str, Any], model: type[Config]) -> ConfigError:
    """Return the error of a field that pydantic has found, with what it expects."""
    location, place = _find_place(model, detail['loc'])
    kind = detail['type']
    field = '.'.join(map(str, location)) or model.__name__
    if kind == 'extra_forbidden':
        return ConfigError(
            field,
            f'a known key ({", ".join(place.model_fields)})',
            f"unknown key '{location[-1]}'",
        )
    if kind == 'missing':
        return ConfigError(field, 'a value', 'nothing')
    if kind == 'union_tag_invalid':
        context = detail['ctx']
        return ConfigError(
            f'{field}.{KIND}',
            f'one of {context["expected_tags"]}',
            f"'{context['tag']}'",
        )
    expected = KINDS.get(kind, PHRASES.sub('', detail['msg']))
    return ConfigError(field, expected, repr(detail['input']))


def _find_place(
    model: type[Config], location: Sequence[int | str]
) -> tuple[list[int | str], type[Config]]:
    """Return a location without the kinds in it, and the model that its last key stands in."""
    names = []
    kinds: dict[str, type[Config]] = {}
    for index, part in enumerate(location):
        if (
            part in kinds
        ):  # one of several models, named by pydantic: no key of the file
            model = kinds[str(part)]
            kinds = {}
            continue
        names.append(part)
        is_inner = index < len(location) - 1
        if is_inner and part in model.model_fields:
            annotation = model.model_fields[str(part)].annotation
            kinds = dict(list_kinds(annotation))
            model = find_config_model(annotation) or model
    return names, model


def list_kinds(annotation: Any) -> Iterator[tuple[str, type[Config]]]:
    """Yield the configurations among which a type chooses by their `kind`, and that."""
    if isinstance(annotation, type) and issubclass(annotation, Config):
        if KIND in annotation.model_fields:
            yield str(annotation.model_fields[KIND].default), annotation
        return
    for inner_kind in get_args(annotation):
        yield from list_kinds(inner_kind)


def find_config_model(kind: Any) -> type[Config] | None:
    """
    Return the first configuration in a type, e.g. that of the values of a mapping.

    None if there is none in it.
    """
    if isinstance(kind, type) and issubclass(kind, Config):
        return kind
    for inner_kind in get_args(kind):
        model = find_config_model(inner_kind)
        if model is not None:
            return model
    return None


def read_yaml(path: Path) -> dict[str, Any]:
    """
    Read a YAML mapping, as a file of this package or of a user.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not valid YAML (with line and column), or holds anything
        else than a mapping.

    """
    try:
        data = yaml.load(path.read_text(encoding='utf-8'), LOADER)
    except OSError as error:
        raise ConfigError(str(path), hint=error.strerror or str(error)) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        text = ' '.join(str(error).replace('in "<unicode string>", ', 'at ').split())
        raise ConfigError(str(path), 'valid YAML', hint=text) from None
    if not isinstance(data, dict):
        raise ConfigError(str(path), MAPPING, type(data).__name__)
    return data


def read_parameters(path: Path) -> dict[str, Any]:
    """
    Read a ROS 2 parameter file with one section, whatever node it names.

    Raises
    ------
    ConfigError
        For any other file, with the sections that it has.

    """
    sections = dict(_node_sections(read_yaml(path)))
    if len(sections) != 1 or None in sections.values():
        raise ConfigError(
            str(path), "one node key holding 'ros__parameters'", [*sections]
        )
    (parameters,) = sections.values()
    return parameters


def _node_sections(
    data: Mapping[str, Any], place: str = ''
) -> Iterator[tuple[str, Any]]:
    """Yield full name and parameters of each node, in nested namespaces too; None for none."""
    for key, entry in data.items():
        name = f'{place}{key}'
        if not isinstance(entry, dict) or not entry:
            yield name, None
        elif 'ros__parameters' not in entry:
            yield from _node_sections(entry, f'{name}/')
        elif isinstance(entry['ros__parameters'], dict):
            yield name, entry['ros__parameters']
        else:
            yield name, None


def sets_parameter(path: Path, node: str, name: str) -> bool:
    """
    Return whether a ROS 2 parameter file sets a parameter of a node, by its dotted name.

    Sections for all nodes count. It tells a value that a user has chosen from a default of the
    same size.
    """
    for section, parameters in _node_sections(read_yaml(path)):
        concerned = section.rpartition('/')[2] in (node, ANY_NODE, '*')
        if concerned and _holds_parameter(parameters or {}, name):
            return True
    return False


def _holds_parameter(parameters: Mapping[str, Any], name: str) -> bool:
    """Return whether nested parameters, whose names may be dotted, too, hold a dotted name."""
    if name in parameters:
        return True
    return any(
        isinstance(inner, Mapping)
        and name.startswith(f'{key}.')
        and _holds_parameter(inner, name.removeprefix(f'{key}.'))
        for key, inner in parameters.items()
    )


def read_node_parameters(path: Path, nodes: Sequence[str]) -> dict[str, dict[str, Any]]:
    """
    Read a ROS 2 parameter file with at most one section for each of some nodes.

    Sections name a node with or without a namespace; `ANY_NODE` stands for all nodes. Returns
    the parameters by node; ConfigError for any other section, or two of one node.
    """
    by_node: dict[str, dict[str, Any]] = {}
    for key, parameters in _node_sections(read_yaml(path)):
        name = key.rpartition('/')[2]
        found = ''
        if parameters is None:
            found = 'none'
        elif name in by_node:
            found = f"'{name}' again"
        elif name not in nodes:
            found = name
        if parameters is None or found:
            raise ConfigError(
                f'{path}: {key}',
                f"a section of {', '.join(nodes)} holding 'ros__parameters'",
                found,
            )
        by_node[name] = parameters
    return by_node


def merge(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return nested values with others laid over them.

    Mappings are merged key by key; all else, also a list, takes the place of what was there.
    """
    merged = dict(base)
    for key, value in overrides.items():
        if isinstance(value, Mapping) and isinstance(merged.get(key), Mapping):
            merged[key] = merge(merged[key], value)
        else:
            merged[key] = value
    return merged
