"""Force for learning: recordings as datasets."""
