"""Shared by all backgrounds that plan: futures, lanes ahead, choice of attackers, and the safeguard."""
