"""Tests of targets, with a harness for closed-loop figures."""
