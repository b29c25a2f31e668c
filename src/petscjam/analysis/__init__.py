"""Analyses of the response: non-affine motion, correlations, densities, scaling, nonlinear drag."""
