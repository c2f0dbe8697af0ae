"""Reading telemetry files: formats, columns, checks, chunks."""
