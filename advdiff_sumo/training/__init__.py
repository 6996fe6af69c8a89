"""Training, one file per stage; runs without SUMO."""
