"""Packings: what one is, how it is prepared, how it is judged."""
