"""Mission control systems over their HTTP APIs: telemetry out of their archives, events and tables into them.

Nothing here commands a spacecraft: what is handed over lies in the system's store until a person there uses it.
"""
