"""Networks of the traffic model; tensors in, tensors out, without SUMO."""
