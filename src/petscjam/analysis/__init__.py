"""Analyses of the response and of flows: non-affine motion, correlations, densities, scaling, nonlinear drag."""
