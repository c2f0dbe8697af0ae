"""What holds for every request: credentials, limits, idempotency, caching, problems."""

from boresight.platform.web import paging

paging.register()  # before the first route is made
