"""Scheduled backups: when they are due, what became of each, and whether one is missing."""
