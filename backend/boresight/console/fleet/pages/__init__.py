"""The pages of the fleet and its sensors."""
