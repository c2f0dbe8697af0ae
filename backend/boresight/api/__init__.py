"""The REST API: what programs ask over HTTP, and what holds for every request, theirs or a browser's."""
