"""The pictures of the documentation are taken from the product as it is, by one script, and show what they are said to."""

import shutil
import struct

import pytest
from click.testing import CliRunner

from benchmarks.screenshots import METRICS, NAMES, SIZE, main


@pytest.mark.full
@pytest.mark.browser
def test_the_script_takes_every_picture(tmp_path):
    done = CliRunner().invoke(main, ["--out", str(tmp_path)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    wanted = [name for name in NAMES if name != METRICS or shutil.which("prometheus")]
    sizes = {path.stem: struct.unpack(">II", path.read_bytes()[16:24]) for path in tmp_path.iterdir()}
    assert sizes == dict.fromkeys(wanted, (SIZE["width"], SIZE["height"]))
