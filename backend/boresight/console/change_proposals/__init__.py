"""Changes of gate limits and table layouts that wait for a second person."""
