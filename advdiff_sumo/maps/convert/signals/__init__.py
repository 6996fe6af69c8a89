"""Programs of the signals of a converted net: who has green together, yellow and all-red times, cycle lengths."""
