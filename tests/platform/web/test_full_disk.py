"""A disk that is full, for reading only, or not there is one clear sentence, 503 with Retry-After, and nothing is half-stored."""

import errno
import json
import os
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from boresight.cli import main
from boresight.disks import LEAST_FREE_BYTES, refuse_unwritable, storage_error
from boresight.errors import StorageError
from boresight.platform.blobs.folder import FolderBlobStore
from boresight.platform.web.problems import make_problem

ROOT = Path(__file__).resolve().parents[3]
MOUNT = "mount -t tmpfs -o size=32m none {disk} && exec {python} -m tests.platform.web.full_disk {disk}"


@pytest.mark.sqlite("its file is on the disk that is filled")
@pytest.mark.skipif(os.geteuid() != 0 or shutil.which("unshare") is None, reason="only root mounts a small disk")
def test_a_server_on_a_full_disk_says_so_stores_nothing_by_halves_and_goes_on_when_there_is_room(
    tmp_path: Path,
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    script = MOUNT.format(disk=disk, python=sys.executable)
    done = subprocess.run(
        ["unshare", "-m", "sh", "-c", script], cwd=ROOT, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    told = json.loads(done.stdout.splitlines()[-1])
    for name in ("upload", "sensor", "log in"):
        status, retry_after, text = told["full"][name]
        assert (status, retry_after) == (503, "30"), (name, text)
        assert "make room" in json.loads(text)["detail"], (name, text)
    assert told["full"]["ready"][0] == 503
    assert told["read"] == 200
    assert told["left behind"] == []
    assert told["command"][0] == 1
    assert told["command"][1].startswith("boresight: The disk of the database is full")
    assert told["command"][1].count("\n") == 1
    assert told["again"] == 201
    assert told["read only"][0] == 1
    assert told["read only"][1].count("\n") == 1
    assert "cannot be written" in told["read only"][1]


def test_a_limit_on_the_size_of_files_is_a_full_disk_and_leaves_no_scraps(tmp_path: Path) -> None:
    blobs, child = FolderBlobStore(tmp_path / "blobs"), os.fork()
    if child == 0:  # the limit is for good
        resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
        try:
            blobs.put(bytes(50_000))
        except StorageError:
            os._exit(7)
        os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    assert [path for path in blobs.folder.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    ("number", "said"), [(errno.ENOSPC, "is full"), (errno.EDQUOT, "is full"), (errno.EROFS, "cannot be written")]
)
def test_a_system_error_of_a_disk_is_503_with_a_time_to_come_back_and_any_other_is_a_defect(
    number: int, said: str
) -> None:
    problem = make_problem(OSError(number, os.strerror(number), "/data/x"))
    assert (problem.status, problem.headers) == (503, {"Retry-After": "30"})
    assert f"/data/x {said}" in problem.detail
    assert make_problem(OSError(errno.EIO, "io")).status == 500
    assert storage_error(FileNotFoundError(errno.ENOENT, "absent", "x")) is None


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="is not there"):
        refuse_unwritable(tmp_path / "absent" / "file")
    refuse_unwritable(tmp_path / "file")
    assert LEAST_FREE_BYTES > 1 << 20


def test_a_command_whose_data_folder_cannot_be_made_says_so_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    environment = {"BORESIGHT_DATA_FOLDER": str(tmp_path / "file" / "data"), "BORESIGHT_DATABASE_URL": ""}
    done = CliRunner(env=environment).invoke(main, ["audit", "verify"])
    assert (done.exit_code, done.stderr.count("\n")) == (1, 1)
    assert "is not there" in done.stderr
