"""The paper's tables: every row on the same seed scenes, with intervals, beside the paper's own figures."""
