"""PETSc's lifetime, communicators, and errors that must reach every rank."""
