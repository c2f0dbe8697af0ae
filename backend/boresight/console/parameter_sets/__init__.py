"""Parameter sets: immutable, named by sensor and number, one of them a sensor's baseline."""
