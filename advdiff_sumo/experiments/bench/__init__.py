"""Makes the paper's tables: all rows use the same seed scenes; intervals and the paper's figures are added."""
