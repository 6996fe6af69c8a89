"""Lawful manoeuvres that force the target to act: what can be done, what a driver needs to answer it, which is best."""
