"""Alarms: what needs a person, until it was seen and is over."""
