"""Parameters times seeds: from a study's file to a table of summaries."""
