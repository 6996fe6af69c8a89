"""The background ``scripted``: lawful manoeuvres against the target in SUMO's traffic."""
