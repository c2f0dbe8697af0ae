"""The licences of everything that an installation runs on, read from the packages, and which ones are allowed.

A package says its licence as an SPDX expression (`License-Expression`, PEP 639); older ones by a phrase or a classifier, which
`PHRASES` reads, or so loosely that `READ` has what their licence file says. An expression is allowed when the allowed
licences satisfy it: any part of an OR, every part of an AND. Copyleft of a file (MPL) or of a library (LGPL) is allowed, for
these are installed unchanged beside Boresight; of the whole program (GPL, AGPL) is not.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

from license_expression import get_spdx_licensing

ROOT = Path(__file__).resolve().parents[1]
LOCK = re.compile(r"^([a-z0-9.-]+)==([^ \\]+)(?: ; [^\\\n]+)?((?: \\\n +--hash=sha256:[0-9a-f]{64})+)", re.MULTILINE)
ALLOWED = frozenset(
    {
        *(
            "0BSD",
            "Apache-2.0",
            "Apache-2.0 WITH LLVM-exception",
            "BSD-2-Clause",
            "BSD-3-Clause",
            "CC0-1.0",
            "ISC",
            "MIT",
        ),
        *("MIT-0", "MIT-CMU", "PSF-2.0", "Zlib"),
        *("MPL-2.0", "LGPL-3.0-only", "LGPL-3.0-or-later"),
    }
)
PHRASES = {
    "Apache 2.0": "Apache-2.0",
    "Apache License, Version 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD 3-Clause License": "BSD-3-Clause",
    "LGPLv3+": "LGPL-3.0-or-later",
    "MIT License": "MIT",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
}
#: What the licence files say of packages whose metadata say "BSD", or give the whole text.
READ = {
    "itsdangerous": "BSD-3-Clause",
    "jinja2": "BSD-3-Clause",
    "numba": "BSD-2-Clause",
    "partd": "BSD-3-Clause",
    "scipy": "BSD-3-Clause",
    "pyasn1-modules": "BSD-2-Clause",
    "segno": "BSD-3-Clause",
    "uvloop": "MIT OR Apache-2.0",
    "zict": "BSD-3-Clause",
}
SPDX: Any = get_spdx_licensing()


@dataclass(frozen=True)
class Package:
    """A package of an installation, as the lock file names it; `licence` is empty where none could be read."""

    name: str
    version: str
    sha256s: tuple[str, ...]
    licence: str

    @property
    def is_allowed(self) -> bool:
        """Whether the allowed licences satisfy its expression."""
        return bool(self.licence) and _satisfied(SPDX.parse(self.licence, validate=True))


def list_packages(lock: Path = ROOT / "requirements.lock") -> Iterator[Package]:
    """Yield the packages of a lock file, in its order."""
    for name, version, hashes in LOCK.findall(lock.read_text()):
        yield Package(name, version, tuple(sorted(re.findall(r"[0-9a-f]{64}", hashes))), read_licence(name))


def read_licence(name: str) -> str:
    """Return the licence of an installed package as an SPDX expression; empty where it cannot be told."""
    try:
        said = distribution(name).metadata
    except PackageNotFoundError:
        return ""
    classifiers = [one.rpartition(" :: ")[2] for one in said.get_all("Classifier") or () if one.startswith("License")]
    spoken = [*(said.get_all("License-Expression") or ()), READ.get(name, ""), *(said.get_all("License") or ())]
    for text in (*spoken, *classifiers):
        expression = PHRASES.get(text, text)
        if expression and "\n" not in expression and not SPDX.validate(expression).errors:
            return str(SPDX.parse(expression))
    return ""


def _satisfied(expression: Any) -> bool:
    if expression.isliteral:
        return str(expression) in ALLOWED
    parts = [_satisfied(part) for part in expression.args]
    return any(parts) if isinstance(expression, SPDX.OR) else all(parts)


def write_list(packages: list[Package]) -> str:
    """Write the list as a table in Markdown."""
    rows = (f"| `{one.name}` | {one.version} | {one.licence or 'unknown'} |\n" for one in packages)
    return (
        "# Licences of the packages that Boresight runs on\n\n| Package | Version | Licence |\n|---|---|---|\n"
        + "".join(rows)
    )
