"""Linear response: distributed K and B, one solver, sweeps over frequency, moduli."""
