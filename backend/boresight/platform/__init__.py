"""What every part of the console shares: database, blobs, web, background jobs."""
