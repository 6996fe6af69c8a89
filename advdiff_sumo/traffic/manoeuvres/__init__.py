"""Lawful manoeuvres that force the target to respond: proposals, the braking that they require, and the choice."""
