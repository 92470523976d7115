"""The studies there are: each declares its grid, its measure, and what is shown of it."""
