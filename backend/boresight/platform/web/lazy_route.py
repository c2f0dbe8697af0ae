"""A route that works out what it wants of a request when that is first needed.

FastAPI reads the signature of an endpoint, and builds a validator of each parameter, as the route is declared: for some
400 routes a fifth of the server's start, of which a process that is asked for few pages needs little. Which requests
are a route's is known at once; everything else follows with the first of them, or with `prepare`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from fastapi.routing import APIRoute
from starlette.routing import compile_path

#: One for all routes, because FastAPI changes the filters of warnings while it builds, which threads must not do at once.
BUILDING = threading.RLock()


class LazyRoute(APIRoute):
    """A route of FastAPI, declared as one, that is built by the first request for it."""

    def __init__(
        self,
        path: str,
        endpoint: Callable[..., Any],
        *,
        name: str | None = None,
        methods: set[str] | list[str] | None = None,
        **options: Any,
    ) -> None:
        self.path, self.endpoint, self.name = path, endpoint, name or endpoint.__name__
        self.methods = {method.upper() for method in methods or ("GET",)}
        self.path_regex, self.path_format, self.param_convertors = compile_path(path)
        self._options: dict[str, Any] | None = options

    def prepare(self) -> None:
        """Build the route, if it is not yet built; what fails is tried again."""
        with BUILDING:
            options, self._options = self._options, None
            if options is None:
                return
            known = dict(vars(self))
            try:
                self._build(options)
            except BaseException:
                for name in vars(self).keys() - known:
                    delattr(self, name)
                vars(self).update(known, _options=options)
                raise

    def _build(self, options: dict[str, Any]) -> None:
        super().__init__(self.path, self.endpoint, name=self.name, methods=self.methods, **options)

    def __getattr__(self, name: str) -> Any:
        """Build the route for the first attribute that is not there yet."""
        self.prepare()
        return object.__getattribute__(self, name)
