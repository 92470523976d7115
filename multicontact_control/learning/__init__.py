"""Force for robot learning: an environment to learn in, and recordings as datasets."""
