"""What holds for every request: credentials, limits, idempotency, caching, problems."""
