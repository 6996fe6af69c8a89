"""Layout of a net: which parts of source lanes share a SUMO edge, and which lane ends meet in one junction."""
