"""Parts of soak.py: the places that it drives, and what it checks."""
