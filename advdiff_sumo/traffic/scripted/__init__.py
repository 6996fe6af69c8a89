"""The background ``scripted``: lawful manoeuvres against the target, SUMO's traffic all around."""
