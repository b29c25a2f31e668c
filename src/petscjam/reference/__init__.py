"""Slow, dense, loop-written twins of the fast code, for tests and documentation."""
