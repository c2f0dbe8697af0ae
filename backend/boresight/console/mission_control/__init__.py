"""Links to mission control systems: what was pulled for whom, what was told, and how a link fares."""
