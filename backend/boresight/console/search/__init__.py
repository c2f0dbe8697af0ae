"""Finding anything by its name or number, from every page."""
