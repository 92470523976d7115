"""How fast it is: every part against its floor, measured in the same run."""
