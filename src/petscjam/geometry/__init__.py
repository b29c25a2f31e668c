"""Disks in a periodic cell: cells, potentials, neighbours, packings, contact networks."""
