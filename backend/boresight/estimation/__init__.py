"""Pure numbers: camera models, arcs, estimators and the statistics that say whether to trust them.

No web, no database, no clock, no files. A numeric failure is a value with advice; a programming error is a ValueError.
"""

from __future__ import annotations

#: An exposure of fewer stars determines nothing (E, section III: N_min).
MINIMUM_STARS = 4
