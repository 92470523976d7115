"""Namespaces of ROS."""

from __future__ import annotations

import re

from multicontact_control.errors import ConfigError


def check_namespace(namespace: str) -> str:
    """
    Return a namespace without the slashes around it.

    Raises
    ------
    ConfigError
        If ROS would not have it.

    """
    bare = namespace.strip('/')
    if bare and not re.fullmatch(r'[A-Za-z_]\w*(/[A-Za-z_]\w*)*', bare, re.ASCII):
        raise ConfigError(
            'namespace', 'names of letters, digits and _, joined by /', f"'{namespace}'")
    return bare
