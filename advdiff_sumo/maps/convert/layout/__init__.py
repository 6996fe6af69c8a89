"""Layout: which parts of the source's lanes share a SUMO edge, and which ends meet in one junction."""
