"""Packings from and for other programs."""
