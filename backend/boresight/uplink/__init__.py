"""What goes to the spacecraft: camera parameters as the bytes of its table, and the package that carries them.

Nothing here knows a database, a clock or a request: the same inputs give the same bytes, on every machine, for ever.
"""

from __future__ import annotations
