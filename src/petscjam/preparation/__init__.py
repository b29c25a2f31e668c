"""Preparation of packings: random start, minimisation, certificate, libraries."""
