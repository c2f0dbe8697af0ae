"""Background services of a server: event broadcast, maintenance, heartbeat, webhook delivery."""
