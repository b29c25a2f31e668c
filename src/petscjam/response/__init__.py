"""Linear response: distributed K and B, one solver, moduli at many frequencies."""
