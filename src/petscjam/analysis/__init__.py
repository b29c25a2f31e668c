"""What the response says: non-affine motion, correlations, densities, scaling, nonlinear drag."""
