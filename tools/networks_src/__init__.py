"""Layouts and geometry behind the shipped networks (see docs/networks.md)."""
