"""The command line, in this process."""

from multicontact_control.cli.application import app
import pytest
from typer.testing import CliRunner


@pytest.fixture
def multicontact():
    """Return what calls `multicontact` with some arguments, here: it takes no start."""
    return lambda *arguments: CliRunner().invoke(app, arguments)
