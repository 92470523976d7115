"""What explains the readings of an arm, in sentences; no torque needs any of it."""
