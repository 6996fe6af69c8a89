"""What the checks of the reference drivers need: UN R157's scenarios, episodes driven again, agreement of judges."""
