"""Background services of a server: event broadcast, upkeep, heartbeat, webhook delivery."""
