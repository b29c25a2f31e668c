"""The rows of every contact, and the damping laws that weigh them."""
