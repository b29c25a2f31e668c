"""Slow twins of the fast code, with dense matrices and plain loops, for tests and documentation."""
