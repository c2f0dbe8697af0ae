"""Statistics of an estimate: consistency, bounds, observability, uncertainty, drift."""
