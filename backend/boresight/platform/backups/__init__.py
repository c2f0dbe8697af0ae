"""Backups of an installation: encrypted files, where they are stored, and which of them are kept."""
