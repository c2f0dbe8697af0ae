"""The state of the server itself, for load balancers, monitoring and administrators."""
