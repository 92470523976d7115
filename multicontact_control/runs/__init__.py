"""One run: its configuration, its loop in process or as a graph, its recording."""
