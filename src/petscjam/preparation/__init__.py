"""Packings made, minimised, certified, and collected in libraries."""
