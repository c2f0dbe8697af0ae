"""distributed's scheduler, nanny and worker as Boresight starts them: without the web server that each opens beside its link.

That server would speak plain HTTP to whoever asks, whatever the links require. Nothing of Boresight's own is imported here, because
a new worker process reads this module before its environment is set.
"""

from __future__ import annotations

from typing import Any

import distributed


class Scheduler(distributed.Scheduler):  # type: ignore[misc]  # distributed ships no types
    """A scheduler whose link is its only port."""

    def start_http_server(self, *_arguments: Any, **_options: Any) -> None:
        """Open no port."""


class Worker(distributed.Worker):  # type: ignore[misc]  # distributed ships no types
    """A worker whose link is its only port."""

    def start_http_server(self, *_arguments: Any, **_options: Any) -> None:
        """Open no port."""


class Nanny(distributed.Nanny):  # type: ignore[misc]  # distributed ships no types
    """A nanny of such workers; it opens no web server itself."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, worker_class=Worker, **options)
