"""The robot's model and its operational-space quantities."""
