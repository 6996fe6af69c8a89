"""Maps that the converter reads: one module a format, all of them return a SourceMap."""
