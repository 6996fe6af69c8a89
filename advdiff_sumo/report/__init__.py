"""What people look at after a run: the report page, pictures and films of episodes."""
