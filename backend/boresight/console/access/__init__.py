"""People, their log-ins, passwords and API keys."""
