"""Whether what the page is made with is installed."""

from __future__ import annotations

from typing import Any

from multicontact_control.errors import ConfigError


def require_viser() -> Any:
    """Return the module; ConfigError where it, or what it brings, is not installed."""
    try:
        import viser
        import websockets  # noqa: F401
    except ImportError as error:
        raise ConfigError('view', "viser, by pip install 'multicontact_control[view]'",
                          f'none that can be loaded ({error})') from None
    return viser
