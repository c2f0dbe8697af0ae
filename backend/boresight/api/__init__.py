"""The REST API: what programs ask over HTTP, and what holds for every request, theirs or a browser's."""

from boresight.api import segments

segments.register()  # before the first route is made
