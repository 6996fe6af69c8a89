"""Readers of the map formats that can be converted: one module per format; each returns a SourceMap."""
