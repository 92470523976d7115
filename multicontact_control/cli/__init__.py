"""The `multicontact` command."""
