"""Studies: a grid of jobs, each run once and kept; one table of the results, and one page."""
