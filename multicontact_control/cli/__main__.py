"""`python -m multicontact_control.cli`."""

from multicontact_control.cli.application import main

main()
