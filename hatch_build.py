"""What wheel and source archive have besides the source: the documentation, where `make docs` has built it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class DocumentationHook(BuildHookInterface[Any]):
    """Takes the built pages along, the archive to where its wheel finds them; without them the server says how to get them."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the folder to what is built."""
        built = Path(self.root) / "build" / "documentation"
        if version != "editable" and built.is_dir():
            place = "boresight/documentation" if self.target_name == "wheel" else "build/documentation"
            build_data["force_include"][str(built)] = place
