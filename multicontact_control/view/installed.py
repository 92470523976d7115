"""Whether what the page is made with is installed."""

from __future__ import annotations

from typing import Any

from multicontact_control.errors import RunError


def require_viser() -> Any:
    """Return the module; RunError where it, or what it brings, is not installed."""
    try:
        import viser
        import websockets  # noqa: F401
    except ImportError as error:
        raise RunError(f'the page needs viser, which cannot be loaded: {error}; install the extra '
                       "[view]: pip install 'multicontact_control[view]'") from None
    return viser
