"""What the wheel has besides the package: the documentation, where `make docs` has built it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class DocumentationHook(BuildHookInterface[Any]):
    """Takes the built pages along; without them the server says how to get them."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the folder to what is built."""
        built = Path(self.root) / "build" / "documentation"
        if version != "editable" and built.is_dir():
            build_data["force_include"][str(built)] = "boresight/documentation"
