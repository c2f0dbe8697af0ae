"""What a site sees of Boresight from outside: structured logs and traces; `/metrics` is of `platform/web`."""
