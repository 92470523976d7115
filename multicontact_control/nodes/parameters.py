"""
ROS parameters from configuration models.

A model of `multicontact_control.config` says name, type, default, unit, description and range of
every value. Here each becomes a ROS parameter: nested fields get dotted names, a mapping such as
``contacts`` one set of parameters per name in ``contact_names``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
import sys
from types import NoneType
import typing
from typing import Any, Literal, TypeVar

from multicontact_control.config import Config, validate
from multicontact_control.errors import ConfigError
from pydantic.fields import FieldInfo
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

Type = Parameter.Type
ModelT = TypeVar('ModelT', bound=Config)

NAMES_OF_MAPPINGS = 'contact_names'
SET_BY_ROS = ('use_sim_time', 'start_type_description_service', 'qos_overrides')
INTEGER_LIMIT = 2 ** 63 - 1

_SCALAR_TYPES = {bool: Type.BOOL, int: Type.INTEGER, float: Type.DOUBLE, str: Type.STRING}
_ARRAY_TYPES = {
    bool: Type.BOOL_ARRAY, int: Type.INTEGER_ARRAY, float: Type.DOUBLE_ARRAY,
    str: Type.STRING_ARRAY}


@dataclass(frozen=True)
class ParameterSpec:
    """
    One ROS parameter.

    Attributes
    ----------
    name
        Dotted name.
    type
        ROS type.
    default
        Default value, None if there is none.
    descriptor
        What ROS tools show: description with unit, range, read-only flag.

    """

    name: str
    type: Parameter.Type  # noqa: A003
    default: Any
    descriptor: ParameterDescriptor


def parameter_specs(
    model: type[Config], overrides: Mapping[str, Any], prefix: str = '',
) -> Iterator[ParameterSpec]:
    """
    Yield the parameters of a model.

    Parameters
    ----------
    model
        Configuration class.
    overrides
        Values by dotted name; they say which names a mapping has.
    prefix
        Prefix of the dotted names, with its dot.

    """
    for key, field in model.model_fields.items():
        name = prefix + key
        annotation = _without_none(field.annotation)
        if isinstance(annotation, type) and issubclass(annotation, Config):
            yield from parameter_specs(annotation, overrides, f'{name}.')
        elif typing.get_origin(annotation) is dict:
            yield from _mapping_specs(annotation, field, overrides, name)
        else:
            yield _leaf_spec(name, annotation, field)


def _mapping_specs(
    annotation: Any, field: FieldInfo, overrides: Mapping[str, Any], name: str,
) -> Iterator[ParameterSpec]:
    """Yield the parameters of a mapping: those of each name, or one number per name."""
    value_type = _without_annotated(typing.get_args(annotation)[1])
    for entry in _mapping_names(name, overrides):
        if isinstance(value_type, type) and issubclass(value_type, Config):
            yield from parameter_specs(value_type, overrides, f'{name}.{entry}.')
        else:
            yield _leaf_spec(f'{name}.{entry}', value_type, field)


def _mapping_names(name: str, overrides: Mapping[str, Any]) -> list[str]:
    """
    Return the names that a mapping has values for, those in the list of names first.

    A listed name without values is left to the model, which knows what to say about it; only
    if there are no values at all, every listed name gets its defaults.
    """
    listed = [x for x in overrides.get(NAMES_OF_MAPPINGS) or () if isinstance(x, str)]
    start = f'{name}.'
    found = {key[len(start):].split('.')[0]: None for key in overrides if key.startswith(start)}
    return sorted(found, key=lambda x: listed.index(x) if x in listed else len(listed)) or listed


def _leaf_spec(name: str, annotation: Any, field: FieldInfo) -> ParameterSpec:
    ros_type, choices = _ros_type(name, annotation)
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    unit = extra.get('unit')
    descriptor = ParameterDescriptor(
        name=name, type=ros_type.value, read_only=not extra.get('live', False),
        description=(field.description or '') + (f' [{unit}]' if unit else ''),
        additional_constraints=f'one of {", ".join(choices)}' if choices else '')
    _add_range(descriptor, ros_type, field)
    default = None if field.is_required() else field.get_default(call_default_factory=True)
    if isinstance(default, Mapping):
        default = default.get(name.rsplit('.', 1)[-1])
    if isinstance(default, (tuple, list)):
        default = list(default)
    return ParameterSpec(name, ros_type, default, descriptor)


def _ros_type(name: str, annotation: Any) -> tuple[Parameter.Type, tuple[str, ...]]:
    """Return the ROS type of an annotation, and the choices if there are only a few."""
    annotation = _without_annotated(annotation)
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        return Type.STRING, tuple(str(choice) for choice in arguments)
    if origin in (tuple, list) and arguments:
        element = _without_annotated(arguments[0])
        if typing.get_origin(element) is Literal:
            return Type.STRING_ARRAY, tuple(str(c) for c in typing.get_args(element))
        if element in _ARRAY_TYPES:
            return _ARRAY_TYPES[element], ()
    elif annotation in _SCALAR_TYPES:
        return _SCALAR_TYPES[annotation], ()
    raise ConfigError(name, 'a type that a ROS parameter can hold', annotation)


def _without_annotated(annotation: Any) -> Any:
    while typing.get_origin(annotation) is typing.Annotated:
        annotation = typing.get_args(annotation)[0]
    return annotation


def _without_none(annotation: Any) -> Any:
    arguments = typing.get_args(annotation)
    if NoneType in arguments:
        return next(argument for argument in arguments if argument is not NoneType)
    return _without_annotated(annotation)


def _add_range(
    descriptor: ParameterDescriptor, ros_type: Parameter.Type, field: FieldInfo,
) -> None:
    """Add the range of a number; a ROS range is closed, the model is stricter where it is not."""
    bounds: dict[str, Any] = {}
    for constraint in field.metadata:
        for attribute, end in (('ge', 'from'), ('gt', 'from'), ('le', 'to'), ('lt', 'to')):
            value = getattr(constraint, attribute, None)
            if value is not None:
                bounds[end] = value
    if not bounds:
        return
    if ros_type is Type.DOUBLE:
        limit = sys.float_info.max
        descriptor.floating_point_range = [FloatingPointRange(
            from_value=float(bounds.get('from', -limit)),
            to_value=float(bounds.get('to', limit)))]
    elif ros_type is Type.INTEGER:
        descriptor.integer_range = [IntegerRange(
            from_value=int(bounds.get('from', -INTEGER_LIMIT)),
            to_value=int(bounds.get('to', INTEGER_LIMIT)), step=1)]


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by dotted name as nested mappings."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        *path, key = name.split('.')
        level = result
        for depth, part in enumerate(path):
            level = level.setdefault(part, {})
            if not isinstance(level, dict):
                raise ConfigError('.'.join(path[:depth + 1]), 'a mapping', level)
        level[key] = value
    return result


def parameter_overrides(node: Node) -> dict[str, Any]:
    """
    Return what the command line and its parameter files set, by dotted name.

    The public ways to ask refuse an integer where a number is declared, turn an empty list into
    an error, and don't tell of unknown names; hence the look inside. An empty list arrives as
    None.
    """
    overrides: dict[str, Parameter] = getattr(node, '_parameter_overrides')  # noqa: B009
    return {
        name: parameter.value for name, parameter in overrides.items()
        if name.split('.')[0] not in SET_BY_ROS}


def load_parameters(node: Node, *models: type[Config]) -> list[Any]:
    """
    Declare the parameters of some models on a node and return their validated configurations.

    Parameters
    ----------
    node
        The node.
    models
        Configuration classes without common field names.

    Returns
    -------
    list of Config
        One frozen configuration per model.

    Raises
    ------
    ConfigError
        Naming the first parameter that is unknown, missing or not acceptable.

    """
    overrides = parameter_overrides(node)
    given = nested(overrides)
    known = {key for model in models for key in model.model_fields}
    for key in given:
        if key not in known:
            raise ConfigError(
                key, f'a known parameter ({", ".join(sorted(known))})', f"unknown '{key}'")
    configs = []
    for model in models:
        specs = list(parameter_specs(model, overrides))
        values = {
            spec.name: _value(spec, overrides) for spec in specs
            if spec.name in overrides or spec.default is not None}
        # Names without a declaration are kept, for the model to refuse them by name.
        unknown = {
            name: value for name, value in overrides.items()
            if name.split('.')[0] in model.model_fields and name not in values}
        configs.append(validate(model, nested({**unknown, **values})))
        for spec in specs:
            _declare(node, spec, values.get(spec.name))
    return configs


def _value(spec: ParameterSpec, overrides: Mapping[str, Any]) -> Any:
    """Return the value of a parameter, numbers as the declared kind where nothing is lost."""
    value = overrides.get(spec.name, spec.default)
    if value is None:
        # ROS has no type for an empty list in a parameter file.
        return [] if spec.type in _ARRAY_TYPES.values() else value
    if spec.type is Type.DOUBLE and type(value) is int:
        return float(value)
    if spec.type is Type.DOUBLE_ARRAY:
        return [float(x) if type(x) is int else x for x in value]
    return list(value) if spec.type in _ARRAY_TYPES.values() else value


def _declare(node: Node, spec: ParameterSpec, value: Any) -> None:
    """
    Declare one parameter.

    An empty list has no type of its own in rclpy, so the type is declared first, the value set,
    and only then the parameter made read-only.
    """
    open_descriptor = ParameterDescriptor(name=spec.name, type=spec.type.value)
    node.declare_parameter(spec.name, spec.type, open_descriptor, ignore_override=True)
    if value is not None:
        node.set_parameters([Parameter(spec.name, spec.type, value)])
    node.set_descriptor(spec.name, spec.descriptor)
