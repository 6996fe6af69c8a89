"""Scene state, frames, boxes, vehicle motion and seeds: NumPy only, no SUMO, no maps."""
