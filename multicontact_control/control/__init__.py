"""The composed control law and what feeds it."""
