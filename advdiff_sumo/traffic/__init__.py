"""Policies that move the background vehicles."""
