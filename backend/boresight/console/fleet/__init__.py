"""Star trackers, the state of the fleet, and each sensor over the mission."""
