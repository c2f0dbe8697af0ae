"""Importing a file, small or of another program."""

from pathlib import Path

import pytest

from boresight.telemetry.imports.builtin import BUILT_IN
from boresight.telemetry.imports.mapping import SourceFile, import_files
from boresight.telemetry.imports.profile import parse_profile

VECTORS = Path(__file__).parent / "vectors"


def source(path, name=None):
    return SourceFile(Path(path), name or Path(path).name)


@pytest.fixture
def load(tmp_path):
    """Import content, or a file of the vectors, by a built-in profile or what one says."""

    def imported(content, profile, name="pass.csv", **given):
        path = content
        if not isinstance(content, Path):
            path = tmp_path / name
            path.write_bytes(content if isinstance(content, bytes) else content.encode())
        named = BUILT_IN[profile] if isinstance(profile, str) else parse_profile({"name": "mine", **profile})
        files = {key: source(given.pop(key)) for key in ("orbit", "attitude") if key in given}
        return import_files([source(path)], named, **files, **given)

    return imported
