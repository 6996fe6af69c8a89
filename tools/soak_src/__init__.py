"""Parts of soak.py: its places and its checks."""
