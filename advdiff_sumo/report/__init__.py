"""Presents the results of a run: the report page, pictures and films of episodes."""
