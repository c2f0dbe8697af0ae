"""Alarms: conditions that need a person, until one has acknowledged them and they are over."""
