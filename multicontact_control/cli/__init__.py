"""The `multicontact` command, a file for each of its commands."""

from multicontact_control.cli.application import app, main

__all__ = ['app', 'main']
