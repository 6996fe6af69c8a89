"""Signal programs of a converted net: which links have green together, yellow and all-red times, cycle lengths."""
